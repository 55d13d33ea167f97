"""Protection of many messages as arrays, for the compiled receive loop: constants and memory.

`dbc.protection.Receiver` says the same for one message and is what tests compare this with.
The checksum tables come from the library `autosar-e2e`, byte by byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from e2e.crc import calculate_crc8_h2f, calculate_crc16
from numpy.typing import NDArray

from dbc.frame import FD
from dbc.protection import COUNTERS, WINDOW, Check, Profile, SmState
from dbc.spec import MessageSpec

Ints = NDArray[np.int64]

_EVERY_BYTE: Final = [bytes([k]) for k in range(256)]
CRC8_H2F: Final = np.array(
    [calculate_crc8_h2f(_EVERY_BYTE[k ^ 0xFF]) ^ 0xFF for k in range(256)], dtype=np.uint8
)
"""Of one byte, without start value and final inversion (both 0xFF): undone on either side."""
CRC16_CCITT: Final = np.array(
    [calculate_crc16(_EVERY_BYTE[k ^ 0xFF]) ^ 0xFF00 for k in range(256)], dtype=np.uint16
)
"""Of one byte, without the start value 0xFFFF."""


class Guard(NamedTuple):
    """Constants, a row per message.

    profile, modulus (counter values), length (bytes), fd (the FD flag or 0), all (C,); ids
    (C, 16) uint8: the P02 list, or the P05 id's low and high byte; crc8, crc16: the tables.
    """

    profile: Ints
    modulus: Ints
    length: Ints
    fd: Ints
    ids: NDArray[np.uint8]
    crc8: NDArray[np.uint8]
    crc16: NDArray[np.uint16]


class Window(NamedTuple):
    """Memory, a row per message.

    counter (C,): last counter, -1 none; cycles (C, 5): the last verdicts, `at` (C,) the oldest
    of them; oks, errors (C,): how many of them are; state (C,): SmState; missed (C,): frames
    that the last verdict proved lost.
    """

    counter: Ints
    cycles: NDArray[np.uint8]
    at: Ints
    oks: Ints
    errors: Ints
    state: Ints
    missed: Ints


def guard(specs: Sequence[MessageSpec]) -> Guard:
    """Constants of these messages, numbered in this order."""
    ids = np.zeros((len(specs), 16), dtype=np.uint8)
    for row, spec in zip(ids, specs, strict=True):
        own = spec.data_ids[::-1] if spec.profile is Profile.P05 else spec.data_ids
        row[: len(own)] = list(own)

    def each(values: list[int]) -> Ints:
        return np.array(values, dtype=np.int64).reshape(len(specs))

    return Guard(
        each([spec.profile for spec in specs]),
        each([COUNTERS[spec.profile] for spec in specs]),
        each([spec.length for spec in specs]),
        each([FD if spec.is_fd else 0 for spec in specs]),
        ids,
        CRC8_H2F,
        CRC16_CCITT,
    )


def window(messages: int) -> Window:
    """Nothing received yet."""
    zeros = [np.zeros(messages, dtype=np.int64) for _ in range(6)]
    counter, at, oks, errors, state, missed = zeros
    counter[:] = -1
    state[:] = SmState.NO_DATA
    cycles = np.full((messages, WINDOW), Check.NO_NEW_DATA, dtype=np.uint8)
    return Window(counter, cycles, at, oks, errors, state, missed)
