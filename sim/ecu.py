"""The inverter's electronic control unit: what a drive sends on the bus and what it obeys.

May know: bits, CANopen, the drive's readings. May not know: how the plant works, the gateway.

It obeys the gateway's flag of its own drive (`Gateway_Adhesion`, protection checked): on
`AdhesionLost` its torque limiter falls to 30 % within 100 ms, on `Adhering` it returns to 100 %
over 1 s. It ignores bad flag frames. If the flag is unknown, or no good flag frame came for 40 ms,
the limiter returns too, and the drive's own slip limiter, if the scenario has one, acts alone.

With a verifier it obeys only flag frames that `Gateway_Auth` authenticates.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.arrays import Array, Flags, Ints
from dbc.codec import Codec
from dbc.e2e import Check, Receiver, SmState, crc_ok, protect
from dbc.frame import BRS, FD, MS, Frame, Nanos
from dbc.spec import MessageSpec
from sim.canopen_ecu import CanopenNode
from sim.faults import EMERGENCY, WireFaults
from sim.measurements import CURRENTS, SAMPLES, VOLTAGES, Values

if TYPE_CHECKING:
    from dbc.secoc_receiver import Verifier


FLAG_TIMEOUT_NS: Final[Nanos] = 40 * MS
LATENCY_NS: Final[Nanos] = 30_000
"""From the sampling instant until the frame waits for the bus; drive k adds k x 7 us."""
KINDS: Final = ("PhaseCurrents", "StatorVoltages", "Samples", "Motion", "Status", "Temperatures")
FAST: Final = {"PhaseCurrents": CURRENTS, "StatorVoltages": VOLTAGES, "Samples": SAMPLES}
"""Messages sent in blocks, and the columns of their values."""
LOST: Final = 2
"""`AdhesionLost`."""


class Ecu:
    """One drive's ECU. `index` counts drives from 0, `node` is its CANopen number."""

    def __init__(
        self, node: int, index: int, codec: Codec, wire: WireFaults, *, self_start: bool,
        verifier: Verifier | None = None,
    ) -> None:  # fmt: skip
        """Boots at time 0. verifier: selects the authentic flag frames; None: all count."""
        self.node, self._wire = node, wire
        self.codec = codec
        prefix = f"Drive{node}_"
        self.specs: dict[str, MessageSpec] = {
            kind: codec.by_name[prefix + kind] for kind in KINDS if prefix + kind in codec.by_name
        }
        self._flags = {s: FD | (BRS if m.brs else 0) for s, m in self.specs.items() if m.is_fd}
        self._latency = LATENCY_NS + 7_000 * index
        self._last: dict[str, tuple[Nanos, bytearray]] = {}
        self.canopen = CanopenNode(node, self.specs, self._read, self_start=self_start)
        adhesion = codec.by_name.get("Gateway_Adhesion")
        self._adhesion = adhesion
        self._receiver = Receiver(adhesion) if adhesion else None
        signals = adhesion.signals if adhesion else ()
        self._shift = next((s.start for s in signals if s.name == f"Adhesion{node}"), 0)
        self.verifier = verifier
        self._vouched = {
            spec.can_id: spec
            for name in ("Gateway_Adhesion", "Gateway_Faults", "Gateway_Auth")
            if (spec := codec.by_name.get(name)) is not None
        }
        self._flag_ns: Nanos | None = None
        self._flag = 0
        self._known_fault = 1
        self.fault_code = 0

    def _read(self, kind: str) -> tuple[MessageSpec, bytes] | None:
        """For the SDO server: the message of this kind as of its last sampling instant."""
        last = self._last.get(kind)
        return (self.specs[kind], self._protected(kind, *last)) if last is not None else None

    def _protected(self, kind: str, instant_ns: Nanos, payload: bytearray) -> bytes:
        """Add protection; the counter is the instant's number, so it keeps time across losses."""
        spec = self.specs[kind]
        protect(spec, payload, instant_ns // spec.cycle_ns)
        return bytes(payload)

    def receive(self, frames: Iterable[Frame], now_ns: Nanos) -> None:
        """Take received frames; `now_ns` is the time at which they take effect."""
        flag_id = self._adhesion.can_id if self._adhesion else -1
        sdo_id = 0x600 + self.node
        for frame in frames:
            if not frame.is_plain_data:
                continue
            if self.verifier is not None and frame.can_id in self._vouched:
                self._verify(self.verifier, self._vouched[frame.can_id], frame, now_ns)
            elif frame.can_id == flag_id:
                self._receive_flags(frame, now_ns)
            elif frame.can_id in (0, sdo_id) and not frame.is_fd:
                self.canopen.deliver(frame.can_id, frame.data, now_ns)

    def _verify(self, verifier: Verifier, spec: MessageSpec, frame: Frame, now_ns: Nanos) -> None:
        """Hold a flag frame back until `Gateway_Auth` authenticates it.

        The stamps of reception count: a program that stalls between the two frames loses neither.
        """
        if len(frame.data) != spec.length or frame.is_fd != spec.is_fd:
            return
        if spec.kind != "Auth":
            verifier.flag(spec.key, frame.data, frame.t_ns)
            return
        if not crc_ok(spec, frame.data):
            return
        values = self.codec.decode(spec, frame.data)
        genuine = verifier.auth(int(values["Freshness"].raw), int(values["Mac"].raw), frame.t_ns)
        if genuine is not None and self._adhesion and genuine.key == self._adhesion.key:
            self._receive_flags(frame._replace(can_id=genuine.key, data=genuine.data), now_ns)

    def _receive_flags(self, frame: Frame, now_ns: Nanos) -> None:
        spec, receiver = self._adhesion, self._receiver
        if spec is None or receiver is None or not self.canopen.operational:
            return
        if len(frame.data) != spec.length or frame.is_fd != spec.is_fd:
            return
        verdict = receiver.check(frame.data)
        state = receiver.cycle(verdict)
        if verdict in (Check.OK, Check.OK_SOME_LOST) and state is SmState.VALID:
            self._flag = int.from_bytes(frame.data, "little") >> self._shift & 3
            self._flag_ns = now_ns

    def cut(self, t_ns: Ints) -> Flags:
        """(n,) whether the limiter is commanded down at times `t_ns` (n,)."""
        if self._flag != LOST or self._flag_ns is None:
            return np.zeros(len(t_ns), np.bool_)
        out: Flags = t_ns < self._flag_ns + FLAG_TIMEOUT_NS
        return out

    def flag(self, t_ns: Nanos) -> int:
        """The gateway's flag of this drive's adhesion: 1 `Adhering`, 2 `AdhesionLost`, else 0.

        0 also where no good flag frame came for 40 ms.
        """
        fresh = self._flag_ns is not None and t_ns < self._flag_ns + FLAG_TIMEOUT_NS
        return self._flag % 3 if fresh else 0

    def note_fault(self, fault_class: int, now_ns: Nanos) -> None:
        """Send EMCY when a fault begins, changes or ends; an undetectable one counts as none."""
        known = fault_class if fault_class in EMERGENCY else 1
        if known == self._known_fault:
            return
        self._known_fault = known
        self.fault_code = 0 if known == 1 else known
        code, register = EMERGENCY.get(known, (0, 0))
        self.canopen.emergency(code, register | 0x01 if code else 0, now_ns)

    def message(self, kind: str, instant_ns: Nanos, values: Values) -> Frame | None:
        """The frame of a sampling instant, ready for the bus; None where nothing is sent."""
        return self._frame(kind, instant_ns, self.codec.encode(self.specs[kind], values))

    def block(self, kind: str, instants_ns: Ints, values: Array) -> list[Frame]:
        """The frames of n instants (n,) of a fast message; values (n, S), columns FAST[kind]."""
        payloads = self.codec.encode_rows(self.specs[kind], FAST[kind], values)
        pairs = zip(instants_ns.tolist(), payloads, strict=True)
        frames = [self._frame(kind, instant_ns, payload) for instant_ns, payload in pairs]
        return [frame for frame in frames if frame is not None]

    def _frame(self, kind: str, instant_ns: Nanos, payload: bytearray) -> Frame | None:
        """Counter and checksum are added last, when the frame is handed over."""
        self._last[kind] = (instant_ns, payload)
        if not self.canopen.operational:
            return None
        spec = self.specs[kind]
        data = self._protected(kind, instant_ns, payload)
        sent = self._wire.apply(instant_ns * 1e-9, spec.can_id, data)
        if sent is None:
            return None
        return Frame(instant_ns + self._latency, spec.can_id, sent, self._flags.get(kind, 0))

    def service_frames(self, now_ns: Nanos) -> list[Frame]:
        """Heartbeat, EMCY and SDO frames up to `now_ns`, ready for the bus."""
        out = []
        for t_ns, can_id, data in self.canopen.sent_until(now_ns):
            sent = self._wire.apply(t_ns * 1e-9, can_id, data)
            if sent is not None:
                out.append(Frame(t_ns + self._latency, can_id, sent))
        return out
