"""AUTOSAR E2E, profiles 02 and 05: protect a frame, check one, and run the receiver state machine.

`dbc/e2e.c` implements the rules; this module applies them to one message at a time. E2E protects
against faults, not against an attacker.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final

import numpy as np
from _traction_core import ffi, lib

from dbc.frame import FD
from dbc.records import E2E_CONFIG, E2E_STATE, Records
from dbc.spec import MessageSpec, Profile

MAX_DELTA: Final[int] = lib.E2E_MAX_DELTA
"""Largest counter step accepted between two frames: up to two frames may be lost in a row."""
WINDOW: Final[int] = lib.E2E_WINDOW
"""Number of receiver cycles that the state machine evaluates."""
HEADER_BYTES: Final = {Profile.NONE: 0, Profile.P02: 2, Profile.P05: 3}
COUNTERS: Final = {Profile.NONE: 1, Profile.P02: 16, Profile.P05: 256}
"""Number of counter values before the counter wraps to 0."""


class Check(IntEnum):
    """Result of one receiver cycle (AUTOSAR: E2E_PCheckStatusType)."""

    OK = lib.E2E_P_OK
    OK_SOME_LOST = lib.E2E_P_OK_SOME_LOST
    ERROR = lib.E2E_P_ERROR
    REPEATED = lib.E2E_P_REPEATED
    WRONG_SEQUENCE = lib.E2E_P_WRONG_SEQUENCE
    NO_NEW_DATA = lib.E2E_P_NO_NEW_DATA


class SmState(IntEnum):
    """State of the receiver (AUTOSAR: E2E_SMStateType)."""

    NO_DATA = lib.E2E_SM_NO_DATA
    INIT = lib.E2E_SM_INIT
    VALID = lib.E2E_SM_VALID
    INVALID = lib.E2E_SM_INVALID


def p02_data_ids(can_id: int) -> bytes:
    """Profile 2 list of a CAN id: entry i = ((id ^ (id >> 6) * 16) & 0xFF) ^ 2i ^ 4i, i = 0..15.

    The rule for a DBC that lists none. The lists of all messages of the set differ, and every error
    of up to three bits is detected, errors in the counter (which selects the entry) included.
    """
    base = (can_id ^ (can_id >> 6) * 16) & 0xFF
    return bytes(base ^ (2 * i) ^ (4 * i) for i in range(16))


def configs(specs: Sequence[MessageSpec]) -> Records:
    """Protection of these messages, (N,) of `struct e2e_config`."""
    found = np.zeros(len(specs), E2E_CONFIG)
    for row, spec in zip(found, specs, strict=True):
        own = spec.data_ids[::-1] if spec.profile is Profile.P05 else spec.data_ids
        row["length"], row["profile"] = spec.length, spec.profile
        row["fd"] = FD if spec.is_fd else 0
        row["data_id"][: len(own)] = list(own)
    return found


def states(messages: int) -> Records:
    """Initial states of receivers without any frame yet, (N,) of `struct e2e_state`."""
    found = np.zeros(messages, E2E_STATE)
    for state in ffi.from_buffer("struct e2e_state[]", found):
        lib.e2e_reset(ffi.addressof(state))
    return found


@lru_cache(maxsize=1024)
def _config(profile: Profile, data_ids: bytes, length: int) -> Any:
    own = data_ids[::-1] if profile is Profile.P05 else data_ids
    given = {"profile": profile, "length": length, "data_id": own.ljust(16, b"\0")}
    return ffi.new("struct e2e_config *", given)


def protect(spec: MessageSpec, payload: bytearray, counter: int) -> None:
    """Write counter (modulo its width) and checksum into the header, in place.

    Raises ValueError for a payload shorter than the header.
    """
    if len(payload) < HEADER_BYTES[spec.profile]:
        msg = f"{len(payload)} bytes are too short for {spec.profile.name}"
        raise ValueError(msg)
    config = _config(spec.profile, spec.data_ids, len(payload))
    lib.e2e_protect(config, ffi.from_buffer("uint8_t[]", payload), counter & 0xFF)


def crc_ok(spec: MessageSpec, data: bytes | bytearray) -> bool:
    """Whether the checksum fits; False for data shorter than the header, True without one."""
    config = _config(spec.profile, spec.data_ids, len(data))
    return bool(lib.e2e_crc_fits(config, ffi.from_buffer("uint8_t[]", data)))


def counter_of(spec: MessageSpec, data: bytes | bytearray) -> int | None:
    """Counter of a frame; None if it is not protected or its data are too short."""
    profile = spec.profile
    if profile is Profile.NONE or len(data) < HEADER_BYTES[profile]:
        return None
    return data[1] & 0x0F if profile is Profile.P02 else data[2]


class Receiver:
    """Counter check and state machine of one message.

    `check` checks a frame; `cycle` feeds the state machine once per receiver cycle (with
    NO_NEW_DATA if no frame was received). The first good frame sets the expected counter, and a
    jump sets it anew: a restart of the sender costs one WRONG_SEQUENCE. `lost` counts the frames
    that the counter shows to be missing; `missed` is the number that the last check added to it.
    """

    __slots__ = ("_data_ids", "_profile", "_state", "counts", "lost")

    def __init__(self, spec: MessageSpec) -> None:
        """Start in NO_DATA with an empty window."""
        self._profile, self._data_ids = spec.profile, spec.data_ids
        self.counts = [0] * len(Check)
        """Number of frames with each result; the index is a `Check`."""
        self.lost = 0
        self._state = states(1)

    def check(self, data: bytes) -> Check:
        """Check one frame's counter, not its age. Never raises, whatever the bytes are."""
        config = _config(self._profile, self._data_ids, len(data))
        frame = ffi.from_buffer("uint8_t[]", data)
        found = lib.e2e_check(config, ffi.from_buffer("struct e2e_state *", self._state), frame)
        self.counts[found] += 1
        self.lost += self.missed
        return Check(found)

    def cycle(self, check: Check) -> SmState:
        """Feed the result of one receiver cycle; returns the new state."""
        state = ffi.from_buffer("struct e2e_state *", self._state)
        return SmState(lib.e2e_sm_check(state, check))

    @property
    def state(self) -> SmState:
        """State of the state machine."""
        return SmState(self._state[0]["state"])

    @property
    def missed(self) -> int:
        """Number of frames that the counter of the last frame shows to be lost."""
        return int(self._state[0]["missed"])
