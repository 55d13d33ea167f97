"""Compiled writing of candump lines: data frames, as bytes. Its twin is `logline.format_frame`.

What a line may not be, or is seldom (remote and error frames, raw lengths), is left to the twin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._candump_kernels import FD_LENGTH
from dbc._lean import inlined, lean

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]
Number = int | np.int64

MOST_LINE = 192
"""Bytes that a line takes at most: stamp 22, name 21, identifier 8, flags, data 128, marks."""
_EXTENDED, _FD, _BRS, _ESI = 1, 8, 16, 32  # dbc.frame
_PLAIN = _EXTENDED | _FD | _BRS | _ESI
_SECOND, _LAST_NS = 1_000_000_000, 9_000_000_000 * 1_000_000_000 - 1
_SPACE, _OPEN, _CLOSE, _DOT, _HASH, _NEWLINE, _ZERO = 32, 40, 41, 46, 35, 10, 48
DIGITS = np.frombuffer(b"0123456789ABCDEF", dtype=np.uint8).copy()


@inlined
def _decimal(number: Number, count: int, out: Bytes, at: int) -> int:
    """`count` decimal digits; the place behind them."""
    for k in range(count):
        out[at + count - 1 - k] = _ZERO + number % 10
        number //= 10
    return at + count


@inlined
def _hexadecimal(number: Number, count: int, digits: Bytes, out: Bytes, at: int) -> int:
    for k in range(count):
        out[at + k] = digits[(number >> (4 * (count - 1 - k))) & 15]
    return at + count


@inlined
def _plain(
    t_ns: Number, can_id: Number, kind: Number, length: int, dlc: int, fd_length: NDArray[np.bool_]
) -> bool:
    """Whether this is a data frame that a line can say without a raw length."""
    if kind & ~_PLAIN or dlc > 8 or not 0 <= t_ns <= _LAST_NS:
        return False
    if can_id > (0x1FFF_FFFF if kind & _EXTENDED else 0x7FF):
        return False
    if kind & _FD:
        return length <= 64 and bool(fd_length[length])
    return length <= 8 and not kind & (_BRS | _ESI)


@lean
def write_lines(
    first: int, t_ns: Ints, can_id: NDArray[np.uint32], flags: Bytes, length: Bytes, data: Bytes,
    dlc: NDArray[np.int8], channel: NDArray[np.uint16], names: Bytes, sizes: Ints, digits: Bytes,
    fd_length: NDArray[np.bool_], out: Bytes,
) -> tuple[int, int]:  # fmt: skip
    """Lines of a `Block`'s frames from `first` on, as long as they are plain and there is room.

    names (K, 21), sizes (K,): the channels' names, size 0 for one that no line can have. Gives the
    first frame that is not written, and how much of `out` is filled.
    """
    at, row = 0, first
    while row < t_ns.shape[0] and at + MOST_LINE <= out.shape[0]:
        t, kind, count, name = t_ns[row], np.int64(flags[row]), length[row], channel[row]
        identifier = np.int64(can_id[row])
        if not _plain(t, identifier, kind, count, dlc[row], fd_length) or sizes[name] == 0:
            break
        seconds, rest = t // _SECOND, t % _SECOND
        out[at] = _OPEN
        at = _decimal(seconds, 10, out, at + 1)
        out[at] = _DOT
        if rest % 1000:
            at = _decimal(rest, 9, out, at + 1)
        else:
            at = _decimal(rest // 1000, 6, out, at + 1)
        out[at], out[at + 1] = _CLOSE, _SPACE
        at += 2
        for k in range(sizes[name]):
            out[at + k] = names[name, k]
        at += sizes[name]
        out[at] = _SPACE
        at = _hexadecimal(identifier, 8 if kind & _EXTENDED else 3, digits, out, at + 1)
        out[at] = _HASH
        at += 1
        if kind & _FD:
            out[at] = _HASH
            bits = (1 if kind & _BRS else 0) | (2 if kind & _ESI else 0)
            at = _hexadecimal(bits, 1, digits, out, at + 1)
        for k in range(count):
            at = _hexadecimal(np.int64(data[row, k]), 2, digits, out, at)
        out[at] = _NEWLINE
        at += 1
        row += 1
    return row, at


__all__ = ["DIGITS", "FD_LENGTH", "MOST_LINE", "write_lines"]
