"""One received message of one drive: its protection state, its age, and why it is not believed."""

from __future__ import annotations

from typing import Final

from dbc.codec import MessageSpec
from dbc.frame import FD, Nanos
from dbc.protection import WINDOW, Check, Profile, Receiver, SmState
from gateway.health import Reason

SAMPLE_NS: Final[Nanos] = 125_000
"""Spacing of the eight samples in a FD frame, and the filters' sub-step."""

# The signals the gateway uses of each kind, in the order in which the inbox takes them.
USED: Final = {
    "PhaseCurrents": ("Ia", "Ib", "Ic"),
    "StatorVoltages": ("Ualpha", "Ubeta"),
    "Samples": (
        "SampleIndex",
        *(f"{name}_{k}" for k in range(8) for name in ("Ia", "Ib", "Ualpha", "Ubeta")),
    ),
    "Motion": ("Speed", "Torque"),
    "Status": ("TorqueCommand", "Irms"),
    "Temperatures": ("Tstator", "Tde", "Tnde", "Tambient"),
}

_REASON = {
    Check.ERROR: Reason.CORRUPTED,
    Check.REPEATED: Reason.SEQUENCE,
    Check.WRONG_SEQUENCE: Reason.SEQUENCE,
}


class Channel:
    """State of one message. The inbox feeds it; everybody else only asks."""

    __slots__ = (
        "blame", "cause", "check", "drive", "fd", "good_ns", "heard_ns", "index", "kind",
        "last_ns", "length", "limit_ns", "number", "period_ns", "picked", "protected",
        "quality", "receiver", "seen_valid", "slow", "spec", "state", "steps",
    )  # fmt: skip

    def __init__(self, spec: MessageSpec, drive: int, tick_ns: Nanos) -> None:
        """drive: position in the configuration; the age limit is three periods and a tick."""
        columns = {signal.name: k for k, signal in enumerate(spec.signals)}
        self.spec = spec
        self.drive = drive
        self.kind = spec.kind
        self.slow = spec.kind in ("Motion", "Status", "Temperatures")
        self.length = spec.length
        self.period_ns = spec.cycle_ns
        self.limit_ns = 3 * spec.cycle_ns + tick_ns
        self.index = spec.index
        self.fd = FD if spec.is_fd else 0
        self.number = -1
        """Position among the inbox's channels."""
        self.check = Check.NO_NEW_DATA
        self.steps = max(1, round(spec.cycle_ns / SAMPLE_NS))
        self.receiver = Receiver(spec)
        self.protected = spec.profile is not Profile.NONE
        self.quality = columns.get("Quality", -1)
        self.picked = tuple(columns[name] for name in USED[spec.kind] if name in columns)
        self.heard_ns: Nanos | None = None
        self.last_ns: Nanos | None = None
        self.good_ns: Nanos | None = None
        self.cause = Reason.NONE
        self.blame = Reason.NONE
        self.state = Reason.STARTING
        self.seen_valid = False

    def verify(self, data: bytes, t_ns: Nanos) -> bool:
        """Judge protection and counter of one frame (`check`) and advance the receiver's window.

        True only for the plain case: good, and part of an unbroken good stream.
        """
        if not self.protected:
            self.last_ns = t_ns
            self.seen_valid = True
            return True
        receiver = self.receiver
        self.check = check = receiver.check(data, t_ns)
        if check is Check.OK:
            self.last_ns = t_ns
            if receiver.oks_seen == WINDOW and receiver.state is SmState.VALID:
                # A full window of good frames: one more changes nothing.
                return True
        for _ in range(receiver.missed):
            receiver.cycle(Check.NO_NEW_DATA)
        state = receiver.cycle(check)
        if check is Check.OK or check is Check.OK_SOME_LOST:
            self.last_ns = t_ns
            if state is SmState.VALID:
                self.seen_valid = True
        else:
            self.cause = self.blame = _REASON[check]
        return False

    def malformed(self) -> None:
        """A frame with our id that cannot be our message: as bad as a wrong checksum."""
        self.receiver.cycle(Check.ERROR)
        self.cause = self.blame = Reason.CORRUPTED

    def settle(self, now: Nanos) -> None:
        """End of a tick: notice silence, and say why the channel is not believed (`state`)."""
        if self.last_ns is not None and now - self.last_ns > self.limit_ns:
            self.receiver.cycle(Check.NO_NEW_DATA)
        self.state = self._reason(now)

    def _reason(self, now: Nanos) -> Reason:
        heard = self.heard_ns
        if heard is None:
            return Reason.STARTING
        if now - heard > self.limit_ns:
            return Reason.STALE
        cause = self.cause
        if self.protected and self.receiver.state is not SmState.VALID:
            # Single good frames do not end it; the last thing that went wrong is why.
            if self.blame is not Reason.NONE:
                return self.blame
            return Reason.STALE if self.receiver.state is SmState.INVALID else Reason.STARTING
        if self.last_ns is None or now - self.last_ns > self.limit_ns:
            return cause if cause is not Reason.NONE else Reason.STALE
        return cause if cause is Reason.RANGE or cause is Reason.NOT_AVAILABLE else Reason.NONE

    def fresh(self, now: Nanos) -> bool:
        """True while the last good value is within the age limit and can be believed."""
        good = self.good_ns
        return good is not None and now - good <= self.limit_ns and self.state is Reason.NONE
