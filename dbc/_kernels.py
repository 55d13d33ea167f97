"""Compiled bit extraction: a block of frames in one call, and its plain twin.

Tables (built by `dbc._tables`), one row per signal, the rows of a message together:
  rows    int64  (M, 5)   columns as named by the first constants below
  layout  int64  (T, 9)   columns as named by the next
  keys    uint64 (T, 7)   mask, sign bit, lowest and highest valid key, not-available key; the
                          first of a run of keys that are valid for sure, and their number
  factors float64 (T, 4)  scale, offset, lowest and highest physical value (floats only)
  ranges  int64  (R, 2)   multiplexer values, inclusive
  there   uint64 (W,)     which signals of a message are in a frame, a bit for each, by what its
                          selector says

A key is the signal's bits with the sign bit (0 where there is none) turned over, so one unsigned
comparison orders both kinds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dbc._kernelcache import njit
from dbc._lean import inlined

FIRST, SIGNALS, SIMPLE, SELECTOR, THERE = range(5)
"""Of a message: its first table row and number of signals; 1 where one pass reads them: all are
whole within a word, none is special (`KIND`), one selector at most says which of them are there;
that selector's table row, or -1; where its part of `there` begins."""
BYTE, COUNT, SHIFT, BIG, FLOAT, PARENT, FIRST_RANGE, WORD, KIND = range(9)
MASK, SIGN, LOW, HIGH, CODE, SURE, RUN = range(7)
RANGES_PER_SIGNAL_SHIFT = 16
"""FIRST_RANGE holds first * 65536 + count: one column less to load."""
WORD_SHIFT = 6
"""WORD is word * 64 + shift of a signal that lies within one of the payload's eight words, as this
machine reads them or, big-endian, the other way round; any other (-1) is put together from its
bytes."""
IS_CODED, SATURATING, SWAPPED, CHOSEN, SPECIAL = 1, 2, 4, 8, 16
"""Of KIND, what a signal is at one look: its word is read the other way round; it is multiplexed;
it is a float or unsigned of 64 bits."""
_PAIRS, _FOURS = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0000FFFF0000FFFF)

_ALL, _LAST_BIT, _ONE = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(63), np.uint64(1)
Place = int | np.uint64
_VALID, _NOT_AVAILABLE, _RANGE, _SATURATED, _ABSENT = range(5)


@inlined
def _word_of(words: NDArray[np.uint64], i: Place, word: int, kind: int) -> np.uint64:
    """The bits of a signal that lies within one word, and what stands above them."""
    acc = words[i, np.uint64(word >> WORD_SHIFT)]
    if kind & SWAPPED:
        # A compiler makes one instruction of it.
        acc = ((acc & _PAIRS) << np.uint64(8)) | ((acc >> np.uint64(8)) & _PAIRS)
        acc = ((acc & _FOURS) << np.uint64(16)) | ((acc >> np.uint64(16)) & _FOURS)
        acc = (acc << np.uint64(32)) | (acc >> np.uint64(32))
    return acc >> np.uint64(word & ((1 << WORD_SHIFT) - 1))  # type: ignore[no-any-return,unused-ignore]


@inlined
def _bytes_of(payload: NDArray[np.uint8], i: int, t: int, layout: NDArray[np.int64]) -> np.uint64:
    """The same of a signal that does not, byte by byte."""
    at = layout[t, BYTE]
    last = layout[t, COUNT] - 1
    shift = np.uint64(layout[t, SHIFT])
    room = np.uint64(8) - shift
    if layout[t, BIG]:
        # The last byte apart: a 64-bit signal off the byte grid spans nine bytes.
        acc = np.uint64(0)
        for b in range(last):
            acc = (acc << np.uint64(8)) | np.uint64(payload[i, at + b])
        return (acc << room) | (np.uint64(payload[i, at + last]) >> shift)
    acc = np.uint64(payload[i, at]) >> shift
    up = room
    for b in range(1, last + 1):
        acc |= np.uint64(payload[i, at + b]) << up
        up += np.uint64(8)
    return acc


@inlined
def _verdict(key: np.uint64, kind: int, t: Place, keys: NDArray[np.uint64]) -> int:
    """Validity of an integer; nearly always one comparison."""
    if key - keys[t, SURE] < keys[t, RUN]:
        return _VALID
    if kind & IS_CODED and key == keys[t, CODE]:
        return _NOT_AVAILABLE
    if key < keys[t, LOW] or key > keys[t, HIGH]:
        return _RANGE
    if kind & SATURATING and (key == keys[t, LOW] or key == keys[t, HIGH]):
        return _SATURATED
    return _VALID


@inlined
def _read(
    bits: np.uint64,
    t: Place,
    kind: int,
    keys: NDArray[np.uint64],
    factors: NDArray[np.float64],
) -> tuple[float, int]:
    """Value and validity of a signal that is not special."""
    key = bits ^ keys[t, SIGN]
    number = np.int64(key - keys[t, SIGN])
    return np.float64(number) * factors[t, 0] + factors[t, 1], _verdict(key, kind, t, keys)


@inlined
def _read_special(
    u: np.uint64,
    t: int,
    layout: NDArray[np.int64],
    keys: NDArray[np.uint64],
    factors: NDArray[np.float64],
) -> tuple[float, int]:
    """The same of a float, or of an unsigned integer of 64 bits."""
    if not layout[t, FLOAT]:
        code = _verdict(u, layout[t, KIND], t, keys)
        return np.float64(u) * factors[t, 0] + factors[t, 1], code
    if layout[t, FLOAT] == 32:
        x = np.float64(np.uint32(u).view(np.float32)) * factors[t, 0] + factors[t, 1]
    else:
        x = np.uint64(u).view(np.float64) * factors[t, 0] + factors[t, 1]
    return x, _VALID if factors[t, 2] <= x <= factors[t, 3] else _RANGE


@inlined
def _present(
    t: int, first: int, bits: NDArray[np.uint64], layout: NDArray[np.int64],
    keys: NDArray[np.uint64], ranges: NDArray[np.int64],
) -> bool:  # fmt: skip
    """A multiplexed signal is there if its selector, and the selector's own, say so."""
    child = t
    while layout[child, PARENT] >= 0:
        parent = layout[child, PARENT]
        sign = keys[first + parent, SIGN]
        selector = np.int64((bits[parent] ^ sign) - sign)
        start = layout[child, FIRST_RANGE] >> RANGES_PER_SIGNAL_SHIFT
        stop = start + (layout[child, FIRST_RANGE] & ((1 << RANGES_PER_SIGNAL_SHIFT) - 1))
        hit = False
        for r in range(start, stop):
            if ranges[r, 0] <= selector <= ranges[r, 1]:
                hit = True
        if not hit:
            return False
        child = first + parent
    return True


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator,unused-ignore]
def decode_block(
    index: NDArray[np.int32],
    payload: NDArray[np.uint8],
    rows: NDArray[np.int64],
    layout: NDArray[np.int64],
    keys: NDArray[np.uint64],
    factors: NDArray[np.float64],
    ranges: NDArray[np.int64],
    there: NDArray[np.uint64],
    value: NDArray[np.float64],
    validity: NDArray[np.uint8],
) -> None:
    """Decode n frames into value (n, S) and validity (n, S); every cell is written.

    index (n,) message numbers, payload (n, 64) zero-padded. A number out of range gives a row
    of ABSENT. Columns beyond a message's signals are NaN and ABSENT.
    """
    n, width = value.shape
    bits = np.empty(width, np.uint64)
    words = payload.view(np.uint64)
    for i in range(n):
        first = 0
        count = 0
        simple = 0
        here = _ALL
        if 0 <= index[i] < rows.shape[0]:
            m = index[i]
            first, count, selector = rows[m, FIRST], rows[m, SIGNALS], rows[m, SELECTOR]
            simple = count if rows[m, SIMPLE] else 0
            if selector >= 0:
                acc = _word_of(words, i, layout[selector, WORD], layout[selector, KIND])
                here = there[rows[m, THERE] + np.int64(acc & keys[selector, MASK])]
        frame = np.uint64(i)
        for k in range(simple):
            # Unsigned, or each look into an array would ask whether they are negative.
            row, column = np.uint64(first + k), np.uint64(k)
            kind = layout[row, KIND]
            acc = _word_of(words, frame, layout[row, WORD], kind) & keys[row, MASK]
            x, code = _read(acc, row, kind, keys, factors)
            found = (here >> (column & _LAST_BIT)) & _ONE
            value[frame, column] = x if found else np.nan
            validity[frame, column] = code if found else _ABSENT
        for k in range(simple, count):
            t = first + k
            word = layout[t, WORD]
            if word >= 0:
                bits[k] = _word_of(words, i, word, layout[t, KIND]) & keys[t, MASK]
            else:
                bits[k] = _bytes_of(payload, i, t, layout) & keys[t, MASK]
        for k in range(simple, count):
            t = first + k
            kind = layout[t, KIND]
            if kind & CHOSEN and not _present(t, first, bits, layout, keys, ranges):
                x, code = np.nan, _ABSENT
            elif kind & SPECIAL:
                x, code = _read_special(bits[k], t, layout, keys, factors)
            else:
                x, code = _read(bits[k], t, kind, keys, factors)
            value[i, k] = x
            validity[i, k] = code
        for k in range(count, width):
            value[i, k] = np.nan
            validity[i, k] = _ABSENT


def extract(data: bytes, start: int, length: int, big_endian: bool) -> int:
    """Unsigned bits of a signal: the plain twin, by arithmetic on one whole integer.

    `start` as in a DBC. Bits beyond the data read 0.
    """
    mask = (1 << length) - 1
    if not big_endian:
        return (int.from_bytes(data, "little") >> start) & mask
    first = 8 * (start >> 3) + 7 - (start & 7)
    shift = 8 * len(data) - first - length
    whole = int.from_bytes(data, "big")
    return (whole >> shift if shift >= 0 else whole << -shift) & mask


def signed(bits: int, length: int) -> int:
    """Two's complement of `length` bits."""
    return bits - (1 << length) if bits >> (length - 1) else bits


def chain(
    k: int, parents: Sequence[int], hits: Sequence[tuple[tuple[int, int], ...]], raws: Sequence[int]
) -> bool:
    """Whether signal k is present: every selector up its chain has a value of its range."""
    while parents[k] >= 0:
        selector = raws[parents[k]]
        if not any(low <= selector <= high for low, high in hits[k]):
            return False
        k = parents[k]
    return True
