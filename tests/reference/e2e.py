"""AUTOSAR E2E profiles 2 and 5 in Python, which `dbc/e2e.c` is compared with.

The library `autosar-e2e` computes the checksum; it accepts the same frame twice, so the counter
check and the state machine are here.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

from e2e.p02 import e2e_p02_check, e2e_p02_protect
from e2e.p05 import e2e_p05_check, e2e_p05_protect

from dbc.frame import Nanos
from dbc.spec import MessageSpec, Profile

MAX_DELTA: Final = 3
"""Counter steps accepted between two frames: up to two frames may be lost in a row."""
WINDOW: Final = 5
"""Receiver cycles the state machine looks back."""


HEADER_BYTES: Final = {Profile.NONE: 0, Profile.P02: 2, Profile.P05: 3}
COUNTERS: Final = {Profile.NONE: 1, Profile.P02: 16, Profile.P05: 256}
"""How many values the counter has before it wraps to 0."""


class Check(IntEnum):
    """Verdict on one receiver cycle."""

    OK = 0
    OK_SOME_LOST = 1
    ERROR = 2
    REPEATED = 3
    WRONG_SEQUENCE = 4
    NO_NEW_DATA = 5


class SmState(IntEnum):
    """State of the receiver (E2E_SM)."""

    NO_DATA = 0
    INIT = 1
    VALID = 2
    INVALID = 3


class Row(NamedTuple):
    """One state: where it goes by the counts of OK and ERROR in the window."""

    min_ok: int
    max_error: int
    good: SmState
    """With at least `min_ok` and at most `max_error`."""
    errors: SmState
    """With more than `max_error`."""
    otherwise: SmState


TABLE: Final = {
    SmState.INIT: Row(2, 0, SmState.VALID, SmState.INVALID, SmState.INIT),
    SmState.VALID: Row(2, 1, SmState.VALID, SmState.INVALID, SmState.INVALID),
    SmState.INVALID: Row(3, 0, SmState.VALID, SmState.INVALID, SmState.INVALID),
}
"""SWS_E2E_00345. NO_DATA goes to INIT on any verdict but ERROR and NO_NEW_DATA."""

_ROWS: Final = tuple(TABLE.get(state, TABLE[SmState.INIT]) for state in SmState)
_LEAVES_NO_DATA: Final = frozenset(Check) - {Check.ERROR, Check.NO_NEW_DATA}
# Only OK and ERROR are counted: repeats, jumps and silence starve the window of OK instead.
_IS_OK: Final = tuple(int(check in (Check.OK, Check.OK_SOME_LOST)) for check in Check)
_IS_ERROR: Final = tuple(int(check is Check.ERROR) for check in Check)


def protect(spec: MessageSpec, payload: bytearray, counter: int) -> None:
    """Write counter (modulo its width) and checksum into the header, in place.

    Raises ValueError for a payload shorter than the header.
    """
    profile = spec.profile
    if profile is Profile.NONE:
        return
    if len(payload) < HEADER_BYTES[profile]:
        msg = f"{len(payload)} bytes are too short for {profile.name}"
        raise ValueError(msg)
    if profile is Profile.P02:
        payload[1] = payload[1] & 0xF0 | counter & 0x0F
        e2e_p02_protect(payload, spec.data_ids, increment_counter=False)
    else:
        payload[2] = counter & 0xFF
        e2e_p05_protect(payload, int.from_bytes(spec.data_ids, "big"), increment_counter=False)


def crc_ok(spec: MessageSpec, data: bytes | bytearray) -> bool:
    """Whether the checksum fits; False for data shorter than the header, True without one."""
    profile = spec.profile
    if profile is Profile.NONE:
        return True
    if len(data) < HEADER_BYTES[profile]:
        return False
    if profile is Profile.P02:
        return e2e_p02_check(data, spec.data_ids)
    return e2e_p05_check(data, int.from_bytes(spec.data_ids, "big"))


class Receiver:
    """Counter check and state machine of one message.

    `check` judges a frame, `cycle` feeds the window once per receiver cycle (with NO_NEW_DATA
    when nothing came). The first good frame sets the counter; a jump sets it anew, so a
    restarted sender costs one WRONG_SEQUENCE. Counts: ok (OK_SOME_LOST included), error,
    repeated, wrong_sequence, lost (frames the counter proves missing); `missed` is what the
    last check added to lost.
    """

    __slots__ = (
        "_data_id", "_data_ids", "_last", "_mask", "_next", "_profile", "_window", "error",
        "errors_seen", "lost", "missed", "ok", "oks_seen", "repeated", "state", "wrong_sequence",
    )  # fmt: skip

    def __init__(self, spec: MessageSpec) -> None:
        """Start in NO_DATA with an empty window."""
        self._profile = spec.profile
        self._data_ids = spec.data_ids
        self._data_id = int.from_bytes(spec.data_ids, "big") if spec.profile is Profile.P05 else 0
        self._mask = COUNTERS[spec.profile] - 1
        self.ok = self.error = self.repeated = self.wrong_sequence = self.lost = 0
        self.missed = 0
        self.reset()

    def reset(self) -> None:
        """Forget counter and window; the counts stay."""
        self._last = -1
        self._window = [Check.NO_NEW_DATA] * WINDOW
        self._next = 0
        self.oks_seen = 0
        self.errors_seen = 0
        self.state = SmState.NO_DATA

    def check(self, data: bytes, t_ns: Nanos = 0) -> Check:
        """Judge one frame. Never raises, whatever the bytes.

        `t_ns` is not used: only the counter counts here, ages are the caller's.
        """
        self.missed = 0
        if self._profile is Profile.P02:
            if len(data) < 2 or not e2e_p02_check(data, self._data_ids):
                self.error += 1
                return Check.ERROR
            counter = data[1] & 0x0F
        elif self._profile is Profile.P05:
            if len(data) < 3 or not e2e_p05_check(data, self._data_id):
                self.error += 1
                return Check.ERROR
            counter = data[2]
        else:
            self.ok += 1
            return Check.OK
        last = self._last
        self._last = counter
        if last < 0:
            self.ok += 1
            return Check.OK
        delta = (counter - last) & self._mask
        if delta == 1:
            self.ok += 1
            return Check.OK
        if delta == 0:
            self.repeated += 1
            return Check.REPEATED
        if delta <= MAX_DELTA:
            self.ok += 1
            self.missed = delta - 1
            self.lost += self.missed
            return Check.OK_SOME_LOST
        self.wrong_sequence += 1
        return Check.WRONG_SEQUENCE

    def cycle(self, check: Check) -> SmState:
        """Feed the verdict of one receiver cycle; returns the new state."""
        window = self._window
        at = self._next
        old = window[at]
        window[at] = check
        self._next = at + 1 if at + 1 < WINDOW else 0
        self.oks_seen += _IS_OK[check] - _IS_OK[old]
        self.errors_seen += _IS_ERROR[check] - _IS_ERROR[old]
        state = self.state
        if state is SmState.NO_DATA:
            if check in _LEAVES_NO_DATA:
                self.state = SmState.INIT
        else:
            row = _ROWS[state]
            if self.errors_seen > row.max_error:
                self.state = row.errors
            elif self.oks_seen >= row.min_ok:
                self.state = row.good
            else:
                self.state = row.otherwise
        return self.state
