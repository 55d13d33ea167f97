"""One message as another node receives it: checksum, counter, second senders, age. Pure.

The rules are those of the gateway's own receiver (`gateway/core/receive.c`). A frame is accepted
only while the E2E state machine is valid. No frame is used for a second after the last sign of a
second sender. A value older than its age limit is dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from _traction_core import ffi, lib

from dbc.codec import Codec
from dbc.e2e import COUNTERS, WINDOW, Check, Receiver, SmState, counter_of
from dbc.frame import MS, Nanos
from dbc.spec import VALID, Match, MessageSpec, Profile, Reading
from dbc.text import printable
from gateway.core.channel import sequence_guards
from gateway.core.inbox import USABLE

LEAST_LIMIT_NS: Final[Nanos] = 100 * MS
"""A flag frame is sent every 10 ms; ten missing ones are more than a short stall of the monitor."""
NEVER: Final[Nanos] = -1
_MATCH: Final = {Match.WRONG_LENGTH: "wrong_length", Match.WRONG_FORMAT: "wrong_format"}
_CHECK: Final = {
    Check.ERROR: "error",
    Check.REPEATED: "repeated",
    Check.WRONG_SEQUENCE: "wrong_sequence",
}


class Seen:
    """The signals of one accepted frame. None: not available, out of range or absent."""

    __slots__ = ("_readings", "_spec", "usable")

    def __init__(self, spec: MessageSpec | None, readings: Mapping[str, Reading]) -> None:
        """spec: None only if there are no readings."""
        self._spec = spec
        self._readings = readings
        self.usable = bool(readings) and (
            "Quality" not in readings or self.raw("Quality") in USABLE
        )
        """Whether `Quality` marks the values as usable, or the message has no `Quality`."""

    def number(self, name: str) -> float | None:
        """Physical value of a signal."""
        reading = self._readings.get(name)
        return reading.value if reading is not None and reading.validity == VALID else None

    def raw(self, name: str) -> int | None:
        """Raw value of a signal, for enumerations and flags."""
        reading = self._readings.get(name)
        return int(reading.raw) if reading is not None and reading.validity == VALID else None

    def label(self, name: str) -> str | None:
        """Label of a signal's value in the DBC."""
        raw = self.raw(name)
        if raw is None or self._spec is None:
            return None
        label = self._spec.signals[self._spec.column(name)].labels.get(raw)
        return None if label is None else printable(label)


NOTHING: Final = Seen(None, {})


class Track:
    """One message: its last accepted frame, and the reasons why others are rejected."""

    __slots__ = (
        "_codec", "_guard", "_latest", "_receiver", "_seen", "data", "good_ns", "limit_ns",
        "received_ns", "rejected", "spec",
    )  # fmt: skip

    def __init__(self, codec: Codec, spec: MessageSpec, tick_ns: Nanos) -> None:
        """The age limit is three periods and a tick, but at least 100 ms."""
        self._codec = codec
        self.spec = spec
        self.limit_ns = max(LEAST_LIMIT_NS, 3 * spec.cycle_ns + tick_ns)
        self.received_ns = self.good_ns = NEVER
        self.data = b""
        self.rejected = 0
        self._receiver = Receiver(spec)
        self._seen: Seen | None = None
        self._latest = b""
        """The last frame with a correct checksum."""
        self._guard = sequence_guards([spec.cycle_ns])

    def add_frame(self, match: Match, data: bytes, t_ns: Nanos) -> str | None:
        """Check a frame; return why it is rejected, or None if it is accepted. Never raises.

        t_ns: not before that of the last call.
        """
        before, self.received_ns = self.received_ns, t_ns
        cause = self._judge(match, data, t_ns, before)
        if cause is None:
            self.data = data
            self.good_ns = t_ns
            self._seen = None
        elif cause != "not_yet_valid":
            self.rejected += 1
        return cause

    def _judge(self, match: Match, data: bytes, t_ns: Nanos, before: Nanos) -> str | None:
        receiver, spec = self._receiver, self.spec
        if before >= 0 and t_ns - before > self.limit_ns:
            for _ in range(WINDOW):
                receiver.cycle(Check.NO_NEW_DATA)
        if match is not Match.OK:
            receiver.cycle(Check.ERROR)
            return _MATCH.get(match, "wrong_format")
        if spec.profile is Profile.NONE:
            return None
        check = receiver.check(data)
        for _ in range(receiver.missed):
            receiver.cycle(Check.NO_NEW_DATA)
        state = receiver.cycle(check)
        if check is not Check.ERROR:
            self._note_counter(check, data, t_ns)
        if (cause := _CHECK.get(check)) is not None:
            return cause
        return None if state is SmState.VALID and not self.doubled(t_ns) else "not_yet_valid"

    def _note_counter(self, check: Check, data: bytes, t_ns: Nanos) -> None:
        """Look for signs of a second sender in a frame with a correct checksum."""
        repeated, turn = check is Check.REPEATED, COUNTERS[self.spec.profile]
        before, counter = counter_of(self.spec, self._latest), counter_of(self.spec, data)
        ahead = 1 if before is None or counter is None else (counter - before) % turn
        copy = repeated and data == self._latest
        guard = ffi.from_buffer("struct sequence_guard *", self._guard)
        lib.guard_sequence(guard, t_ns, turn if repeated else ahead, copy)
        self._latest = data

    def doubled(self, now: Nanos) -> bool:
        """True while two nodes seem to send this message."""
        return now < int(self._guard["rejected_until_ns"][0])

    def fresh(self, now: Nanos) -> bool:
        """True while the last accepted frame may still be used."""
        if self.good_ns < 0 or now - self.good_ns > self.limit_ns or self.doubled(now):
            return False
        return self.spec.profile is Profile.NONE or self._receiver.state is SmState.VALID

    def seen(self, now: Nanos) -> Seen:
        """The signals of the last accepted frame; `NOTHING` if it may no longer be used."""
        if not self.fresh(now):
            return NOTHING
        if self._seen is None:
            self._seen = Seen(self.spec, self._codec.decode(self.spec, self.data))
        return self._seen
