"""The CANopen side of a simulated inverter: NMT slave, heartbeat, EMCY, SDO server.

Library `canopen`, LocalNode, on a bus object of ours that collects what is sent and runs periodic
tasks on virtual time, so the same node runs on the virtual clock and, fed by a driver, on a real
bus. No threads, no sockets, no clock.

Of the library's ways this file mends: after an NMT reset it stays in INITIALISING for ever (we
boot it again), it answers SDO in STOPPED, and malformed requests raise inside its callbacks.

May know: CANopen. May not know: the plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import can
import canopen

from dbc.frame import Nanos
from dbc.spec import MessageSpec

EDS: Final = Path(__file__).with_name("inverter.eds")
OBJECTS: Final = {
    0x2001: "PhaseCurrents", 0x2002: "StatorVoltages", 0x2003: "Motion",
    0x2004: "Temperatures", 0x2005: "Status",
}  # fmt: skip
"""Manufacturer objects: one record per message, sub-index k = its k-th signal in bit order."""
TPDO: Final = {0x1800 + k: kind for k, kind in enumerate(OBJECTS.values())}
NOT_VALID: Final = 1 << 31
Read = Callable[[str], tuple[MessageSpec, bytes] | None]


class PeriodicTask:
    """A periodic message on virtual time, with the interface of python-can's tasks."""

    def __init__(self, bus: VirtualTimeBus, message: can.Message, period_s: float) -> None:
        """First sent one period from now."""
        self.message, self._bus = message, bus
        self.period_ns: Nanos = round(period_s * 1e9)
        self.next_ns: Nanos = bus.now_ns + self.period_ns

    def modify_data(self, message: can.Message) -> None:
        """Send this from the next time on; the phase stays."""
        self.message = message

    def stop(self) -> None:
        """No more of it."""
        self._bus.tasks.remove(self)


class VirtualTimeBus(can.BusABC):
    """Collects what is sent in `sent` as (ns, id, data); `run_until` drives the periodic tasks."""

    def __init__(self) -> None:
        """At time 0, empty."""
        super().__init__(channel="virtual time")
        self.channel_info = "virtual time"
        self._is_shutdown = True  # holds nothing that would have to be closed
        self.now_ns: Nanos = 0
        self.tasks: list[PeriodicTask] = []
        self.sent: list[tuple[Nanos, int, bytes]] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Collect a frame, stamped with virtual time."""
        self.sent.append((self.now_ns, msg.arbitration_id, bytes(msg.data)))

    def send_periodic(self, msgs: Any, period: float, *_: Any, **__: Any) -> Any:
        """A task on virtual time instead of a thread."""
        task = PeriodicTask(self, msgs, period)
        self.tasks.append(task)
        return task

    def run_until(self, now_ns: Nanos) -> None:
        """Send what falls due up to and including `now_ns`, then be at that time."""
        while self.tasks:
            task = min(self.tasks, key=lambda t: t.next_ns)
            if task.next_ns > now_ns:
                break
            self.now_ns = task.next_ns
            task.next_ns += task.period_ns
            self.send(task.message)
        self.now_ns = now_ns


class CanopenNode:
    """One inverter as a CANopen node. `read` gives (spec, last payload) of a message kind."""

    def __init__(
        self, number: int, specs: Mapping[str, MessageSpec], read: Read, *, self_start: bool
    ) -> None:
        """Boot at time 0: boot-up frame, Pre-operational, Operational too with `self_start`."""
        self._specs, self._read, self._self_start = specs, read, self_start
        self.number = number
        self.bus = VirtualTimeBus()
        self._network = canopen.Network(self.bus)
        self.node = _local_node(number)
        self._network[number] = self.node
        self.node.add_read_callback(self._on_read)
        self._error = 0
        self._boot()

    @property
    def operational(self) -> bool:
        """Whether PDOs are sent and heard."""
        return bool(self.node.nmt.state == "OPERATIONAL")

    def _boot(self) -> None:
        nmt = self.node.nmt
        nmt.stop_heartbeat()
        nmt.state = "RESET"  # sends the boot-up frame
        nmt.state = "PRE-OPERATIONAL"  # starts the heartbeat
        if self._self_start:
            nmt.state = "OPERATIONAL"

    def deliver(self, can_id: int, data: bytes, now_ns: Nanos) -> None:
        """An NMT command or SDO request; anything else, and anything malformed, is ignored."""
        if can_id == 0:
            if len(data) != 2:
                return
        elif can_id != 0x600 + self.number or len(data) != 8 or self.node.nmt.state == "STOPPED":
            return
        self.bus.now_ns = max(self.bus.now_ns, now_ns)
        self._network.notify(can_id, bytearray(data), now_ns * 1e-9)
        if self.node.nmt.state == "INITIALISING":
            self._boot()

    def emergency(self, code: int, register: int, now_ns: Nanos) -> None:
        """EMCY with error code and register, once per change; code 0 is "error reset"."""
        self._error = register
        self.bus.run_until(now_ns)
        if self.node.nmt.state == "STOPPED":
            return
        if code:
            self.node.emcy.send(code, register)
        else:
            self.node.emcy.reset(register)

    def take(self, now_ns: Nanos) -> list[tuple[Nanos, int, bytes]]:
        """Everything sent up to `now_ns`, heartbeats included."""
        self.bus.run_until(now_ns)
        out = self.bus.sent
        self.bus.sent = []
        return out

    def _on_read(self, index: int, subindex: int, **_: object) -> int | None:
        """Values that live outside the object dictionary; None: the dictionary's own."""
        if index == 0x1001:
            return self._error
        if index in TPDO:
            spec = self._specs.get(TPDO[index])
            if subindex == 1 and spec is None:
                return NOT_VALID | _cob(index, self.number)
            if subindex == 1 and spec is not None:
                return spec.can_id
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
            return (
                raw - (1 << signal.length) if signal.is_signed and raw >> signal.length - 1 else raw
            )
        return None


def _local_node(number: int) -> Any:
    """The library's node; Any because its methods carry no types."""
    return canopen.LocalNode(number, _dictionary(number))


@lru_cache(maxsize=128)
def _dictionary(number: int) -> Any:
    """Objects of a node, as the EDS has them; a node keeps its values itself."""
    return canopen.import_od(str(EDS), number)


def _cob(index: int, number: int) -> int:
    """COB-ID of a TPDO in this message set."""
    base = (0x180, 0x280, 0x380, 0x480, 0x1C0)[index - 0x1800]
    return base + number
