"""`check --eds`: the messages that drives send according to their EDS or DCF."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from dbc.text import printable
from gateway.io.device_file import LONGEST_MS, Device, device_of
from gateway.settings.config import Config

MOST_FAULTS: Final = 20


def device_lines(path: Path, config: Config) -> Iterator[str]:
    """Lines of one EDS or DCF. Raises ConfigError if it cannot be read."""
    device = device_of(path)
    at = f"node {device.node}" if device.node else "node 1, because the file names none"
    yield f"device         {printable(path.name)}: {device.name}, {at}"
    yield f"  heartbeat    {_heartbeat(device, config)}"
    for pdo in device.pdos:
        yield f"  TPDO{pdo.number:<9}0x{pdo.can_id:X}, objects: {len(pdo.objects) or 'none known'}"
        for o in pdo.objects:
            bits = f"{o.start}|{o.length}"
            yield f"    {bits:<11}{o.object_index:04X}h.{o.subindex} {o.name}"
    for fault in device.faults[:MOST_FAULTS]:
        yield f"  not read     {fault}"
    if len(device.faults) > MOST_FAULTS:
        yield f"  not read     and {len(device.faults) - MOST_FAULTS} more"


def _heartbeat(device: Device, config: Config) -> str:
    if device.heartbeat_fault:
        return (
            f"1017h {device.heartbeat_fault}, which is not a number of ms from 0 to {LONGEST_MS}: "
            "this device is supervised by its messages only"
        )
    if device.heartbeat_ms is None:
        return "object 1017h is missing: this device is supervised by its messages only"
    if device.heartbeat_ms == 0:
        return "off (1017h is 0): set a period, or it is supervised by its messages only"
    ours = config.canopen.heartbeat_ms
    if ours and ours != device.heartbeat_ms:
        return f"{device.heartbeat_ms} ms (1017h), but [canopen] heartbeat_ms = {ours}"
    return f"{device.heartbeat_ms} ms (1017h)"
