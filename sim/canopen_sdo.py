"""The SDO server of a simulated inverter: objects as in its EDS, values as the drive has them.

Library `canopen`, LocalNode, on a bus object of ours that collects what is sent. No threads, no
sockets, no clock. The server is made with the first request, as reading the EDS takes longer than a
short simulation. NMT, heartbeat and EMCY are in `sim.canopen_ecu`.

May know: CANopen. May not know: the plant.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import canopen

from dbc.spec import MessageSpec

EDS: Final = Path(__file__).with_name("inverter.eds")
OBJECTS: Final = {
    0x2001: "PhaseCurrents", 0x2002: "StatorVoltages", 0x2003: "Motion",
    0x2004: "Temperatures", 0x2005: "Status",
}  # fmt: skip
"""Manufacturer objects: one record per message, sub-index k = its k-th signal in bit order."""
TPDO: Final = {0x1800 + k: kind for k, kind in enumerate(OBJECTS.values())}
COB: Final = dict(zip(TPDO, (0x180, 0x280, 0x380, 0x480, 0x1C0), strict=True))
"""COB-ID of a TPDO in this message set, for node 0."""
NOT_VALID: Final = 1 << 31
HEARTBEAT_TIME: Final = 0x1017
Read = Callable[[str], tuple[MessageSpec, bytes] | None]


class _Bus:
    """Collects what the library sends. Heartbeats are sent by `sim.canopen_ecu`."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, msg: Any) -> None:
        """Take a message."""
        self.sent.append(bytes(msg.data))

    def send_periodic(self, *_: Any) -> _Bus:
        """Return a task that sends nothing."""
        return self

    def stop(self) -> None:
        """End the task."""


class SdoServer:
    """Answers the requests to one node. `read` returns (spec, last payload) of a message kind."""

    def __init__(
        self, number: int, specs: Mapping[str, MessageSpec], read: Read,
        error: Callable[[], int], heartbeat: Callable[[int], None],
    ) -> None:  # fmt: skip
        """error: returns the error register; heartbeat: takes a period written by a client, ms."""
        self.number = number
        self._specs, self._read = specs, read
        self._error, self._heartbeat = error, heartbeat
        self._bus = _Bus()
        # Any: the library's types require a bus of python-can, and its methods have no types.
        library: Any = canopen
        self._network = library.Network(self._bus)
        self.node = library.LocalNode(number, _dictionary(number))
        self._network[number] = self.node
        self.node.add_read_callback(self._on_read)
        self.node.add_write_callback(self._on_write)

    def answer(self, data: bytes, t_s: float) -> list[bytes]:
        """Replies to a request of eight bytes; none if it is malformed."""
        self._bus.sent = []
        self._network.notify(0x600 + self.number, bytearray(data), t_s)
        return self._bus.sent

    def _on_write(self, index: int, data: bytes, **_: object) -> None:
        if index == HEARTBEAT_TIME:
            self._heartbeat(*struct.unpack_from("<H", data))

    def _on_read(self, index: int, subindex: int, **_: object) -> int | None:
        """Value of an object outside the dictionary; None: the dictionary has it."""
        if index == 0x1001:
            return self._error()
        if index in TPDO:
            spec = self._specs.get(TPDO[index])
            if subindex == 1:
                return spec.can_id if spec else NOT_VALID | COB[index] + self.number
            if subindex == 5 and spec is not None:
                return min(math.ceil(spec.cycle_ns / 1e6), 0xFFFF)
            return None
        if index in OBJECTS and subindex:
            last = self._read(OBJECTS[index])
            if last is None:
                return None
            spec, payload = last
            signal = spec.signals[subindex - 1]
            raw = int.from_bytes(payload, "little") >> signal.start & ((1 << signal.length) - 1)
            negative = signal.is_signed and raw >> signal.length - 1
            return raw - (1 << signal.length) if negative else raw
        return None


@lru_cache(maxsize=128)
def _dictionary(number: int) -> Any:
    """Objects of a node, as in the EDS; each node keeps its own values."""
    return canopen.import_od(str(EDS), number)
