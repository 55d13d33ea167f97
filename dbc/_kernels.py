"""Compiled bit extraction: a block of frames in one call, and its plain twin.

Tables (built by `dbc._tables`), one row per signal, the rows of a message together:
  rows    int64  (M, 3)   first table row and number of signals of each message; 1 where all of
                          them are whole within a word and none is special (`KIND`)
  layout  int64  (T, 13)  columns as named by the constants below
  keys    uint64 (T, 5)   mask, key flip, lowest and highest valid key, not-available key
  factors float64 (T, 4)  scale, offset, lowest and highest physical value (floats only)
  ranges  int64  (R, 2)   multiplexer values, inclusive

A key is the raw value as 64-bit two's complement with the top bit flipped where it is signed,
so one unsigned comparison orders both kinds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dbc._lean import inlined

(
    BYTE, COUNT, SHIFT, BIG, LENGTH, SIGNED, FLOAT, HAS_CODE, PARENT, FIRST_RANGE, SATURATES, WORD,
    KIND,
) = range(13)  # fmt: skip
MASK, FLIP, LOW, HIGH, CODE = range(5)
RANGES_PER_SIGNAL_SHIFT = 16
"""FIRST_RANGE holds first * 65536 + count: one column less to load."""
WORD_SHIFT = 6
"""WORD is word * 64 + shift of a signal that lies within one of the payload's eight words, as this
machine reads them or, big-endian, the other way round; any other (-1) is put together from its
bytes."""
IS_SIGNED, IS_CODED, SATURATING, SWAPPED, CHOSEN, SPECIAL = 1, 2, 4, 8, 16, 32
"""Of KIND, what a signal is at one look: its word is read the other way round; it is multiplexed;
it is a float or unsigned of 64 bits."""
_PAIRS, _FOURS = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0000FFFF0000FFFF)

_VALID, _NOT_AVAILABLE, _RANGE, _SATURATED, _ABSENT = range(5)


@inlined
def _word_of(words: NDArray[np.uint64], i: int, word: int, kind: int) -> np.uint64:
    """The bits of a signal that lies within one word, and what stands above them."""
    acc = words[i, word >> WORD_SHIFT]
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
def _verdict(key: np.uint64, kind: int, t: int, keys: NDArray[np.uint64]) -> int:
    """Validity of an integer."""
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
    t: int,
    layout: NDArray[np.int64],
    keys: NDArray[np.uint64],
    factors: NDArray[np.float64],
) -> tuple[float, int]:
    """Value and validity of a signal that is not special."""
    kind = layout[t, KIND]
    u = bits
    if kind & IS_SIGNED:
        free = np.uint64(64 - layout[t, LENGTH])
        u = np.uint64(np.int64(u << free) >> np.int64(free))
    code = _verdict(u ^ keys[t, FLIP], kind, t, keys)
    return np.float64(np.int64(u)) * factors[t, 0] + factors[t, 1], code


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
        code = _verdict(u ^ keys[t, FLIP], layout[t, KIND], t, keys)
        return np.float64(u) * factors[t, 0] + factors[t, 1], code
    if layout[t, FLOAT] == 32:
        x = np.float64(np.uint32(u).view(np.float32)) * factors[t, 0] + factors[t, 1]
    else:
        x = np.uint64(u).view(np.float64) * factors[t, 0] + factors[t, 1]
    return x, _VALID if factors[t, 2] <= x <= factors[t, 3] else _RANGE


@inlined
def _present(
    t: int, first: int, bits: NDArray[np.uint64], layout: NDArray[np.int64],
    ranges: NDArray[np.int64],
) -> bool:  # fmt: skip
    """A multiplexed signal is there if its selector, and the selector's own, say so."""
    child = t
    while layout[child, PARENT] >= 0:
        parent = layout[child, PARENT]
        selector = np.int64(bits[parent])
        if layout[first + parent, SIGNED]:
            spare = np.int64(64 - layout[first + parent, LENGTH])
            selector = (selector << spare) >> spare
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


@njit(cache=True)  # type: ignore[untyped-decorator,unused-ignore]
def decode_block(
    index: NDArray[np.int32],
    payload: NDArray[np.uint8],
    rows: NDArray[np.int64],
    layout: NDArray[np.int64],
    keys: NDArray[np.uint64],
    factors: NDArray[np.float64],
    ranges: NDArray[np.int64],
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
        if 0 <= index[i] < rows.shape[0]:
            first = rows[index[i], 0]
            count = rows[index[i], 1]
        plain = count if count > 0 and rows[index[i], 2] else 0
        for k in range(plain):
            t = first + k
            acc = _word_of(words, i, layout[t, WORD], layout[t, KIND]) & keys[t, MASK]
            value[i, k], validity[i, k] = _read(acc, t, layout, keys, factors)
        for k in range(plain, count):
            t = first + k
            word = layout[t, WORD]
            if word >= 0:
                bits[k] = _word_of(words, i, word, layout[t, KIND]) & keys[t, MASK]
            else:
                bits[k] = _bytes_of(payload, i, t, layout) & keys[t, MASK]
        for k in range(plain, count):
            t = first + k
            kind = layout[t, KIND]
            if kind & CHOSEN and not _present(t, first, bits, layout, ranges):
                x, code = np.nan, _ABSENT
            elif kind & SPECIAL:
                x, code = _read_special(bits[k], t, layout, keys, factors)
            else:
                x, code = _read(bits[k], t, layout, keys, factors)
            value[i, k] = x
            validity[i, k] = code
        for k in range(count, width):
            value[i, k] = np.nan
        for k in range(count, width):
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
