"""Compiled scan of candump text: the plain line of most logs, at memory speed.

Plain: `(sec.frac) name ID#DATA` or `ID##FLAGSDATA`, 11 bits, six or nine decimals, with or
without ` R`/` T` and a carriage return. Everything else is left to `dbc.logline.parse_line`,
which is also what tests compare this with.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, unlocked

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

PLAIN, OTHER, BLANK, COMMENT, MALFORMED = 0, 1, 2, 3, 4
"""What a row is: a frame, or a line that Python must judge, or one that is certainly no frame.

All but frames have their place in the text instead of numbers: text[can_id:t_ns].
"""

_FD_FLAG, _BRS, _ESI = 8, 16, 32  # dbc.frame
_BAD = 255

HEX = np.full(256, _BAD, dtype=np.uint8)
HEX[ord("0") : ord("9") + 1] = np.arange(10)
HEX[ord("A") : ord("F") + 1] = HEX[ord("a") : ord("f") + 1] = np.arange(10, 16)
FD_LENGTH = np.zeros(65, dtype=np.bool_)
FD_LENGTH[[*range(9), 12, 16, 20, 24, 32, 48, 64]] = True
_SPACE, _OPEN, _CLOSE, _DOT, _HASH, _NEWLINE, _RETURN = 32, 40, 41, 46, 35, 10, 13
_DELETE, _R, _T, _TAB, _SEMICOLON, _SLASH, _D = 127, 82, 84, 9, 59, 47, 68
_SHORTEST = 17
"""Characters of the shortest frame, `(0.000000) a 123#`; a DROPCOUNT has more."""
_MOST_NAME = 21
_MOST_GAP = 21


@inlined
def _digits(text: Bytes, at: int, count: int) -> int:
    """Decimal number of `count` digits; -1 if one is none. By twos: half as long a chain."""
    number = np.int64(0)
    odd = count & 1
    bad = False
    if odd:
        number = np.int64(text[at]) - 48
        bad = bool(number < 0 or number > 9)
    for k in range(at + odd, at + count, 2):
        tens, ones = np.int64(text[k]) - 48, np.int64(text[k + 1]) - 48
        bad = bool(bad or tens < 0 or tens > 9 or ones < 0 or ones > 9)
        number = 100 * number + (10 * tens + ones)
    return -1 if bad else int(number)


@inlined
def _stamp(text: Bytes, at: int, end: int) -> tuple[int, int]:
    """(nanoseconds, place behind the bracket) of a stamp; place -1 if it is none."""
    if at >= end or text[at] != _OPEN:
        return 0, -1
    dot = at + 1
    while dot < end and dot - at <= 11 and text[dot] != _DOT:
        dot += 1
    count = dot - at - 1
    if dot >= end or count < 1 or count > 10 or (count == 10 and text[at + 1] == 57):
        return 0, -1
    seconds = _digits(text, at + 1, count)
    for decimals, scale in ((6, 1000), (9, 1)):
        close = dot + 1 + decimals
        if close < end and text[close] == _CLOSE:
            fraction = _digits(text, dot + 1, decimals)
            if seconds < 0 or fraction < 0:
                return 0, -1
            return seconds * 1_000_000_000 + fraction * scale, close + 1
    return 0, -1


@inlined
def _gap(text: Bytes, at: int, end: int) -> int:
    """Place behind 1 .. 21 blanks; -1 if there are none, or more."""
    k = at
    while k < end and text[k] == _SPACE:
        k += 1
    return k if 0 < k - at <= _MOST_GAP else -1


@inlined
def _named(text: Bytes, at: int, size: int, names: Bytes, sizes: Ints) -> int:
    """Number of an interface name, entered if it is new; -1 if the table is full."""
    for n in range(sizes.shape[0]):
        if sizes[n] == 0:
            sizes[n] = size
            for k in range(size):
                names[n, k] = text[at + k]
            return n
        if sizes[n] == size:
            same = True
            for k in range(size):
                if names[n, k] != text[at + k]:
                    same = False
                    break
            if same:
                return n
    return -1


@inlined
def _line(
    text: Bytes,
    start: int,
    total: int,
    row: int,
    t_ns: Ints,
    can_id: NDArray[np.uint32],
    flags: Bytes,
    length: Bytes,
    data: Bytes,
    channel: NDArray[np.uint16],
    names: Bytes,
    sizes: Ints,
    hexes: Bytes,
    fd_length: NDArray[np.bool_],
) -> int:
    """Fill a row from the line at text[start]; place of its line end, -1 if it is not plain.

    Nothing that is plain goes past a line end, so nobody looks for it first.
    """
    t, at = _stamp(text, start, total)
    if at < 0:
        return -1
    name = _gap(text, at, total)
    if name < 0:
        return -1
    at = name
    while at < total and text[at] > _SPACE and text[at] != _DELETE:
        at += 1
    size = at - name
    if size < 1 or size > _MOST_NAME:
        return -1
    at = _gap(text, at, total)
    if at < 0 or at + 4 > total or text[at + 3] != _HASH:
        return -1
    a, b, c = hexes[text[at]], hexes[text[at + 1]], hexes[text[at + 2]]
    if a > 7 or _BAD in (b, c):
        return -1
    identifier = (np.uint32(a) << 8) | (np.uint32(b) << 4) | np.uint32(c)
    at += 4
    kind = 0
    if at < total and text[at] == _HASH:
        if at + 1 > total - 1 or hexes[text[at + 1]] == _BAD:
            return -1
        bits = hexes[text[at + 1]]
        kind = _FD_FLAG | (_BRS if bits & 1 else 0) | (_ESI if bits & 2 else 0)
        at += 2
    most = 64 if kind else 8
    count = 0
    while at + 1 < total:
        high, low = hexes[text[at]], hexes[text[at + 1]]
        if _BAD in (high, low):
            break
        if count == most:
            return -1
        data[row, count] = (high << 4) | low
        count += 1
        at += 2
    if kind and not fd_length[count]:
        return -1
    if at + 2 < total and text[at] == _SPACE and text[at + 1] in (_R, _T):
        at += 2
    if at + 1 < total and text[at] == _RETURN:
        at += 1
    if at >= total or text[at] != _NEWLINE:
        return -1
    number = _named(text, name, size, names, sizes)
    if number < 0:
        return -1
    for k in range(count, 64):
        data[row, k] = 0
    t_ns[row] = t
    can_id[row] = identifier
    flags[row] = kind
    length[row] = count
    channel[row] = number
    return at


@inlined
def _no_frame(text: Bytes, start: int, end: int) -> int:
    """What text[start:end] is, without its line end: see `dbc.logline.parse_line`."""
    if end > start and text[end - 1] == _RETURN:
        end -= 1
    at = start
    while at < end and (text[at] == _SPACE or text[at] == _TAB):
        at += 1
    if at == end:
        return BLANK
    first = text[start]
    if first in (_HASH, _SEMICOLON):
        return COMMENT
    if first == _SLASH and end > start + 1 and text[start + 1] == _SLASH:
        return COMMENT
    return OTHER if end - start >= _SHORTEST and first in (_OPEN, _D) else MALFORMED


@unlocked
def scan(
    text: Bytes,
    start: int,
    t_ns: Ints,
    can_id: NDArray[np.uint32],
    flags: Bytes,
    length: Bytes,
    data: Bytes,
    channel: NDArray[np.uint16],
    what: Bytes,
    names: Bytes,
    sizes: Ints,
    hexes: Bytes,
    fd_length: NDArray[np.bool_],
) -> tuple[int, int]:
    """Lines of text[start:], a row each, until the rows or the line ends run out.

    `what` (R,) says what each is: PLAIN, or one of those that have no numbers.
    names (K, 21), sizes (K,): the interface names met. Returns the number of rows and the place
    behind the last line read.
    """
    row = 0
    at = start
    total = text.shape[0]
    while row < what.shape[0]:
        end = _line(
            text, at, total, row, t_ns, can_id, flags, length, data, channel, names, sizes,
            hexes, fd_length,
        )  # fmt: skip
        what[row] = PLAIN
        if end < 0:
            end = at
            while end < total and text[end] != _NEWLINE:
                end += 1
            if end == total:
                break
            what[row] = _no_frame(text, at, end)
            can_id[row] = at
            t_ns[row] = end
        row += 1
        at = end + 1
    return row, at
