"""The CANopen side of a simulated inverter: NMT slave, heartbeat, EMCY; SDO in `sim.canopen_sdo`.

On virtual time, so the same node runs on the virtual clock and, fed by a driver, on a real bus. No
threads, no sockets, no clock. CiA 301 for states, commands and formats.

May know: CANopen. May not know: the plant.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from dbc.frame import MS, Nanos
from dbc.spec import MessageSpec

if TYPE_CHECKING:
    from sim.canopen_sdo import SdoServer

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
STATE_OF: Final = {
    1: OPERATIONAL, 2: STOPPED, 80: 80, 96: 96, 128: PRE_OPERATIONAL,
    129: INITIALISING, 130: INITIALISING,
}  # fmt: skip
"""NMT command -> state; 80 and 96: sleep and standby of CiA 320."""
HEARTBEAT_MS: Final = 100
"""Object 0x1017 of the EDS, until it is written."""
EMCY: Final = struct.Struct("<HB5s")
Read = Callable[[str], tuple[MessageSpec, bytes] | None]


class CanopenNode:
    """One inverter as a CANopen node. `read` returns (spec, last payload) of a message kind."""

    def __init__(
        self, number: int, specs: Mapping[str, MessageSpec], read: Read, *, self_start: bool
    ) -> None:
        """Boot at time 0: boot-up frame, then Pre-operational, or Operational with `self_start`."""
        self._specs, self._read, self._self_start = specs, read, self_start
        self.number = number
        self.state = INITIALISING
        self._now_ns: Nanos = 0
        self._sent: list[tuple[Nanos, int, bytes]] = []
        self._heartbeat_ms = HEARTBEAT_MS
        self._next_ns: Nanos = 0
        """Time of the next heartbeat, if it has a period."""
        self._sdo: SdoServer | None = None
        self._error = 0
        self._boot()

    @property
    def operational(self) -> bool:
        """Whether PDOs are sent and received."""
        return self.state == OPERATIONAL

    def _boot(self) -> None:
        self._send(0x700, bytes((INITIALISING,)))
        self._set_heartbeat(self._heartbeat_ms)
        self.state = OPERATIONAL if self._self_start else PRE_OPERATIONAL

    def _set_heartbeat(self, period_ms: int) -> None:
        """Set the period; the first heartbeat is due one period from now. 0: no heartbeat."""
        self._heartbeat_ms = period_ms
        self._next_ns = self._now_ns + period_ms * MS

    def _send(self, base: int, data: bytes) -> None:
        self._sent.append((self._now_ns, base + self.number, data))

    def _run_until(self, now_ns: Nanos) -> None:
        """Send the heartbeats due up to and including `now_ns`, then be at that time."""
        while self._heartbeat_ms and self._next_ns <= now_ns:
            self._now_ns = self._next_ns
            self._next_ns += self._heartbeat_ms * MS
            self._send(0x700, bytes((self.state,)))
        self._now_ns = now_ns

    def deliver(self, can_id: int, data: bytes, now_ns: Nanos) -> None:
        """Take an NMT command or SDO request; any other or malformed frame is ignored."""
        if can_id == 0:
            if len(data) == 2:
                self._command(data[0], data[1], now_ns)
        elif can_id == 0x600 + self.number and len(data) == 8 and self.state != STOPPED:
            self._now_ns = max(self._now_ns, now_ns)
            for answer in self._server().answer(data, now_ns * 1e-9):
                self._send(0x580, answer)

    def _command(self, command: int, number: int, now_ns: Nanos) -> None:
        self._now_ns = max(self._now_ns, now_ns)
        if number not in (0, self.number) or command not in STATE_OF:
            return
        self.state = STATE_OF[command]
        if self.state == INITIALISING:
            self._boot()

    def _server(self) -> SdoServer:
        if self._sdo is None:
            from sim.canopen_sdo import SdoServer

            self._sdo = SdoServer(
                self.number, self._specs, self._read, lambda: self._error, self._set_heartbeat
            )
        return self._sdo

    def emergency(self, code: int, register: int, now_ns: Nanos) -> None:
        """Send EMCY with error code and register; call once per change. Code 0: "error reset"."""
        self._error = register
        self._run_until(now_ns)
        if self.state != STOPPED:
            self._send(0x080, EMCY.pack(code, register, b""))

    def sent_until(self, now_ns: Nanos) -> list[tuple[Nanos, int, bytes]]:
        """Everything sent up to `now_ns`, heartbeats included."""
        self._run_until(now_ns)
        out, self._sent = self._sent, []
        return out
