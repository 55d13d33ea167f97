"""Pieces of the chain tests: configurations for a slow machine, flag changes from a recording."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dbc.candump import Reader
from dbc.codec import Codec
from dbc.protection import Check, Receiver, crc_ok
from gateway.config import shipped_dbc

if TYPE_CHECKING:
    from conftest import Vcan

PATIENCE_S = 90.0
TICK_NS = 10_000_000


class Change(NamedTuple):
    """A flag of one drive, and when it came on the wire."""

    t_ns: int
    flag: int


@contextmanager
def memory_folder() -> Iterator[Path]:
    """A folder in memory: writing to the host's files stops a user-mode kernel altogether."""
    folder = Path(tempfile.mkdtemp(dir="/dev/shm"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def slower(folder: Path, fast_ms: int = 5) -> Path:
    """The classic message set for a slow bus: a copy of the DBC that says so, as users make it.

    Currents and voltages at `fast_ms` instead of 2 ms, Motion at 20 ms instead of 10.
    """
    text = shipped_dbc("traction.dbc").read_text(encoding="cp1252")
    for base, cycle in ((0x180, fast_ms), (0x280, fast_ms), (0x380, 20)):
        for node in range(1, 17):
            text, count = re.subn(
                rf'(BA_ "GenMsgCycleTime" BO_ {base + node}) \d+;', rf"\1 {cycle};", text
            )
            assert count == 1
    path = folder / "slow.dbc"
    path.write_text(text, encoding="cp1252")
    return path


def wait_for(listening: object, what: str) -> None:
    """Poll a condition; the machine may be very slow."""
    deadline = time.monotonic() + PATIENCE_S
    while not listening():  # type: ignore[operator]
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s"
        time.sleep(0.05)


def settled(vcan: Vcan, path: Path) -> None:
    """The gateway is on the bus: its frames are in the recording."""
    del vcan
    wait_for(lambda: path.stat().st_size > 4000, "gateway on the bus")


def adhesion_changes(path: Path, codec: Codec, nodes: tuple[int, ...]) -> dict[int, list[Change]]:
    """Changes of every drive's adhesion flag in a log, start included."""
    spec = codec.by_name["Gateway_Adhesion"]
    changes: dict[int, list[Change]] = {n: [] for n in nodes}
    for frame in Reader(path):
        if frame.can_id != spec.can_id:
            continue
        values = codec.decode(spec, frame.data)
        for n in nodes:
            flag = int(values[f"Adhesion{n}"].raw)
            if not changes[n] or changes[n][-1].flag != flag:
                changes[n].append(Change(frame.t_ns, flag))
    return changes


def protected(path: Path, codec: Codec) -> int:
    """Number of the gateway's frames in a log; each is good and follows the one before."""
    receivers = {m.can_id: Receiver(m) for m in codec.messages if m.is_gateway}
    count = 0
    for frame in Reader(path):
        receiver = receivers.get(frame.can_id)
        if receiver is not None:
            assert crc_ok(codec.by_id[frame.can_id], frame.data)
            assert receiver.check(frame.data) is Check.OK
            count += 1
    return count
