"""Compiled E2E: checksum, counter and the receiver's state machine of one frame.

Twin: `dbc.protection.Receiver`. The numbers are those of its enumerations.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined

if TYPE_CHECKING:
    from dbc.receive import Guard, Window

Bytes = NDArray[np.uint8]

_NONE, _P02 = 0, 1  # dbc.protection.Profile
_OK, _SOME_LOST, _ERROR, _REPEATED, _WRONG_SEQUENCE, _NO_NEW_DATA = range(6)  # Check
_NO_DATA, _INIT, _VALID, _INVALID = range(4)  # SmState
_MAX_DELTA, _WINDOW = 3, 5


@inlined
def sum_p02(data: Bytes, row: int, c: int, guard: Guard) -> np.uint8:
    """Checksum (profile 2) of a frame of message c, its bytes in a row of data (n, 64)."""
    crc = np.uint8(0xFF)
    for k in range(1, guard.length[c]):
        crc = guard.crc8[crc ^ data[row, k]]
    crc = guard.crc8[crc ^ guard.ids[c, data[row, 1] & 0x0F]]
    return crc ^ np.uint8(0xFF)  # type: ignore[no-any-return,unused-ignore]


@inlined
def sum_p05(data: Bytes, row: int, c: int, guard: Guard) -> np.uint16:
    """The same of profile 5."""
    n = guard.length[c]
    wide = np.uint16(0xFFFF)
    for k in range(2, n + 2):
        byte = data[row, k] if k < n else guard.ids[c, k - n]
        wide = np.uint16(np.uint16(wide << 8) ^ guard.crc16[(wide >> 8) ^ byte])
    return wide


@inlined
def crc_fits(data: Bytes, row: int, c: int, guard: Guard) -> bool:
    """Whether the checksum of a frame of message c fits; false for one shorter than its header."""
    n = guard.length[c]
    if guard.profile[c] == _P02:
        return bool(n >= 2 and sum_p02(data, row, c, guard) == data[row, 0])
    if n < 3:
        return False
    told = np.uint16(data[row, 0]) | np.uint16(np.uint16(data[row, 1]) << 8)
    return bool(sum_p05(data, row, c, guard) == told)


@inlined
def judge(data: Bytes, row: int, c: int, guard: Guard, memory: Window) -> int:
    """`Receiver.check`: the verdict on one frame of the right length; the counter is kept."""
    memory.missed[c] = 0
    if guard.profile[c] == _NONE:
        return _OK
    if not crc_fits(data, row, c, guard):
        return _ERROR
    counter = np.int64(data[row, 1] & 0x0F if guard.profile[c] == _P02 else data[row, 2])
    last = memory.counter[c]
    memory.counter[c] = counter
    if last < 0:
        return _OK
    delta = (counter - last) % guard.modulus[c]
    if delta == 1:
        return _OK
    if delta == 0:
        return _REPEATED
    if delta <= _MAX_DELTA:
        memory.missed[c] = delta - 1
        return _SOME_LOST
    return _WRONG_SEQUENCE


@inlined
def cycle(c: int, check: int, memory: Window) -> int:
    """`Receiver.cycle`: feed one verdict to the window of message c; returns the new state."""
    at = memory.at[c]
    old = memory.cycles[c, at]
    memory.cycles[c, at] = check
    memory.at[c] = (at + 1) % _WINDOW
    memory.oks[c] += int(check <= _SOME_LOST) - int(old <= _SOME_LOST)
    memory.errors[c] += int(check == _ERROR) - int(old == _ERROR)
    state = memory.state[c]
    if state == _NO_DATA:
        if check not in (_ERROR, _NO_NEW_DATA):
            state = _INIT
    else:
        # dbc.protection.TABLE: fewest OK and most ERROR by which a state is, or becomes, valid.
        least = 3 if state == _INVALID else 2
        most = 1 if state == _VALID else 0
        if memory.errors[c] > most:
            state = _INVALID
        elif memory.oks[c] >= least:
            state = _VALID
        elif state != _INIT:
            state = _INVALID
    memory.state[c] = state
    return int(state)
