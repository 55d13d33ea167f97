"""Vector's ASC: the format of its lines.

This module exists because python-can's reader loses the line behind a short header, takes
`timestamps relative` for absolute, drops lines before the trigger, and stops at unknown lines
(docs/upstream/asc.md).
Times are those of the file: seconds since the first trigger, also behind a second trigger.
"""

from __future__ import annotations

import re
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, SECOND, TX
from dbc.logs.asc_dates import date_of, nanoseconds_between
from dbc.logs.format import (
    CLASSIC_BYTES,
    FD_SIZES,
    MOST_DLC,
    Format,
    Head,
    Line,
    framed,
    nanoseconds,
    words_of,
)
from dbc.logs.lines import shape_of
from dbc.logs.times import Differences

_PLAIN: Final = (
    r"[ \t]*(-?\d+\.\d+)[ \t]+"
    r"(\d{1,3}[ \t]+[0-9A-Fa-f]{1,10}[xX]?[ \t]+(?:[RT]x|TxRq)[ \t]+d[ \t]+0?[0-8])"
    r"(?![^ \t\n])((?:[ \t]+[0-9A-Fa-f]{1,3}(?![^ \t\n]))*).*"
)
_TIMED: Final = re.compile(r"(-?\d+(?:\.\d*)?)\s+(\S.*)")
_BASE: Final = re.compile(r"base\s+(hex|dec)\b(?:.*\btimestamps\s+(absolute|relative))?", re.I)
_TRIGGER: Final = re.compile(r"begin\s+triggerblock\b(.*)", re.I)
_HEADER: Final = re.compile(r"date\b|end\s+triggerblock|(?:no\s+)?internal\s+events", re.I)
_NUMBER: Final = re.compile(r"\bID\s*=\s*(\d+)(x?)(?!\w)", re.I)
"""Decimal identifier behind the data of a frame, whose identifier column may hold a name."""
_NAMED: Final = re.compile(
    r"^\s*[\d.-]+\s+\d+\s+([A-Za-z_]\w*)\s+(?:[RT]x|TxRq)\b.*\bID\s*=\s*(\d+)(x?)(?!\w)",
    re.I | re.M,
)
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{1,3}")
_DIRECTIONS: Final = frozenset({"rx", "tx", "txrq"})
_SHAPE: Final = shape_of(SECOND, 0, 5, "d", 3)
"""Channel, identifier, direction, `d`, length."""
_RTR, _EDL = 0x10, 0x1000
"""Bits in the flags of a CANFD line."""


class Asc(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    regex = re.compile(rf"^(?:{_PLAIN}|(.*))$", re.MULTILINE)
    shape = _SHAPE
    has_names = True

    def __init__(self) -> None:
        """Start as for a log without a header: hexadecimal, with absolute times."""
        self._base = 16
        self._differences: Differences | None = None
        self._first: datetime | None = None
        self._block: datetime | None = None
        self._offset_ns = 0
        self._latest_ns = 0
        self._blocks, self._begins = 0, False
        self._numbers: dict[str, tuple[int, int]] = {}
        self.notes: list[str] = []

    def learn(self, text: str) -> None:
        """Learn the identifiers of names, which could be read as hexadecimal numbers."""
        if "ID =" in text:
            for name, number, extended in _NAMED.findall(text):
                self._numbers[name] = int(number), EXTENDED if extended else 0

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times since the first trigger: differences summed, times of later blocks shifted."""
        if not timed.any():
            return times
        if self._differences is not None:
            times = self._differences.continued(times, timed)
        else:
            first = times[timed].item(0)
            if self._begins and first + self._offset_ns < self._latest_ns:
                self._offset_ns = self._block_ns(first)
            times = times + self._offset_ns
        self._block, self._begins = None, False
        self._latest_ns = times[timed].item(-1)
        return times

    def _block_ns(self, first_ns: int) -> int:
        """Time from the first block to this one, whose times start again at its own trigger."""
        if self._first and self._block:
            return nanoseconds_between(self._first, self._block)
        self.notes.append(
            "times restart at a date that cannot be read: they continue without a gap"
        )
        return self._latest_ns - first_ns

    def data(self, text: str, length: int) -> bytes:
        """Bytes with blanks between them, in the number base of the log."""
        if self._base == 16:
            return super().data(text, length)
        return bytes(map(int, text.split()))

    def whole(self, text: str) -> bool:
        """False for decimal bytes, because a further digit may be missing."""
        del text
        return self._base == 16

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `channel id direction d length` of a plain line."""
        channel, name, direction, _, length = words_of(parts[0])
        if not channel.isdecimal() or direction not in ("Rx", "Tx", "TxRq"):
            return Head(0, verdict=Verdict.MALFORMED)
        request = Verdict.REQUEST if direction == "TxRq" else Verdict.OK
        found = self._numbers.get(name) or self._id(name)
        if found is None:
            return Head(0, verdict=Verdict.BAD_ID)
        if not length.isdecimal() or int(length) > CLASSIC_BYTES:
            return Head(0, verdict=Verdict.MALFORMED)
        number, flags = found[0], found[1] | _sent(direction)
        return Head(number, flags, int(length), _channel(channel), -1, request)

    def _id(self, text: str) -> tuple[int, int] | None:
        digits = text.rstrip("xX")
        try:
            return int(digits, self._base), EXTENDED if len(digits) < len(text) else 0
        except ValueError:
            return None

    def changes(self, text: str) -> bool:
        """True for a line with base and kind of time, and for the start of a block."""
        return bool(_BASE.match(text.strip()) or _TRIGGER.match(text.strip()))

    def line(self, text: str) -> Line:
        """Parse a header, an event, or a frame: remote, error, CAN FD, or with a name as id."""
        text = text.strip()
        if text.startswith(("//", "#", ";")):
            return Line(Verdict.COMMENT)
        if match := _TIMED.fullmatch(text):
            t_ns = None
            try:
                t_ns = nanoseconds([match[1]]).item()
                return self._timed(t_ns, words_of(match[2]), text)
            except (ValueError, OverflowError, IndexError):
                # The time is kept, because those of later lines may be relative to it.
                return Line(Verdict.MALFORMED, None, t_ns)
        if match := _BASE.match(text):
            self._base = 16 if match[1].lower() == "hex" else 10
            self.shape = _SHAPE if self._base == 16 else None
            relative = (match[2] or "").lower() == "relative"
            self._differences = Differences(self._latest_ns) if relative else None
            return Line(Verdict.HEADER)
        if match := _TRIGGER.match(text):
            self._block, self._begins = date_of(match[1]), self._blocks > 0
            self._first = self._first if self._begins else self._block
            self._blocks += 1
            return Line(Verdict.HEADER)
        return Line(Verdict.HEADER if _HEADER.match(text) else Verdict.MALFORMED)

    def _timed(self, t_ns: int, words: list[str], text: str) -> Line:
        if words[0].upper() == "CANFD" and words[1].isdecimal():
            return self._fd(t_ns, words)
        if not words[0].isdecimal():
            event = words[0][0].isalpha() or words[0][0] == "_"
            return Line(Verdict.EVENT if event else Verdict.MALFORMED, None, t_ns)
        channel = _channel(words[0])
        if words[1].lower().startswith("errorframe"):
            return framed(Head(0, ERROR, 0, channel), t_ns, sure=True)
        if len(words) < 3 or words[2].lower() not in _DIRECTIONS:
            event = len(words) > 2 and words[1][0].isalpha() and self._id(words[1]) is None
            event = event or words[1].lower() == "overloadframe"
            return Line(Verdict.EVENT if event else Verdict.MALFORMED, None, t_ns)
        if words[2].lower() == "txrq":
            return Line(Verdict.REQUEST, None, t_ns)
        found = self._numbers.get(words[1]) or self._id(words[1])
        sure = True
        if match := _NUMBER.search(text):
            number, flags = int(match[1]), EXTENDED if match[2] else 0
            # If the number ends the line, digits may be missing.
            sure = match.end() < len(text) or flags != 0 or (number, flags) == found
            found = number, flags
        if found is None:
            return Line(Verdict.BAD_ID, None, t_ns)
        number, flags = found[0], found[1] | _sent(words[2])
        if words[3].lower() == "r":
            asked = words[4] if len(words) > 4 else ""
            dlc = int(asked, self._base) if asked.isalnum() and len(asked) < 3 else 0
            head = Head(number, flags | REMOTE, 0, channel, dlc or -1)
            return framed(head, t_ns, sure=sure and asked != "")
        if words[3].lower() != "d":
            return Line(Verdict.MALFORMED, None, t_ns)
        if size := _fd_size(words[4], words[5:]):
            raw, flags = -1, flags | FD
        else:
            dlc = int(words[4], self._base)
            if dlc > MOST_DLC:
                return Line(Verdict.BAD_LENGTH, None, t_ns)
            size, raw = min(dlc, CLASSIC_BYTES), dlc if dlc > CLASSIC_BYTES else -1
        data = self.data(" ".join(words[5 : 5 + size]), size)
        head = Head(number, flags, size, channel, raw)
        return framed(head, t_ns, data, sure=sure and self._base == 16)

    def _fd(self, t_ns: int, words: list[str]) -> Line:
        """Parse `CANFD channel direction id [name] brs esi dlc length data duration bits flags`."""
        channel = _channel(words[1])
        if words[3].lower().startswith("errorframe"):
            return framed(Head(0, ERROR, 0, channel), t_ns, sure=True)
        if words[2].lower() not in _DIRECTIONS:
            return Line(Verdict.MALFORMED, None, t_ns)
        if words[2].lower() == "txrq":
            return Line(Verdict.REQUEST, None, t_ns)
        number, flags = int(words[3].rstrip("xX"), 16), EXTENDED if words[3][-1] in "xX" else 0
        flags |= _sent(words[2])
        # A name of any form may follow the identifier.
        at = 4 if words[4] in ("0", "1") and _fits(words, 6) else 5
        brs, esi, dlc, size = words[at], words[at + 1], int(words[at + 2], 16), int(words[at + 3])
        body = words[at + 4 : at + 4 + size]
        data = bytes.fromhex(" ".join(body))
        behind = words[at + 4 + size :]
        bits = int(behind[2], 16) if len(behind) > 2 else _EDL
        sure = len(behind) > 3
        if bits & _RTR:
            return framed(Head(number, flags | REMOTE, 0, channel, dlc or -1), t_ns, sure=sure)
        # Some recorders do not set the CAN FD flag.
        if bits & _EDL or size > CLASSIC_BYTES or "1" in (brs, esi):
            flags |= FD | (BRS if brs == "1" else 0) | (ESI if esi == "1" else 0)
        if FD_SIZES[dlc & 15] != size and (flags & FD or min(dlc, CLASSIC_BYTES) != size):
            return Line(Verdict.BAD_LENGTH, None, t_ns)
        return framed(Head(number, flags, size, channel), t_ns, data, sure=sure)


def _fits(words: list[str], at: int) -> bool:
    """Whether the words at `at` are a length code and the length (or 0) that belongs to it."""
    try:
        return int(words[at + 1]) in (0, FD_SIZES[int(words[at], 16)])
    except (ValueError, IndexError):
        return False


def _fd_size(code: str, words: list[str]) -> int:
    """Length of a CAN FD frame that a converter has written as a classic one; 0 for any other.

    The length code of such a frame is decimal or hexadecimal, whatever the base of the log.
    """
    for base in (10, 16):
        dlc = int(code, base) if base == 16 or code.isdecimal() else 0
        if CLASSIC_BYTES < dlc <= MOST_DLC:
            size = FD_SIZES[dlc]
            if sum(map(bool, map(_BYTE.fullmatch, words[:size]))) == size:
                return size
    return 0


def _sent(direction: str) -> int:
    return TX if direction.lower() == "tx" else 0


def _channel(text: str) -> str:
    """Channel counted from 0; Vector counts from 1."""
    return str(max(int(text) - 1, 0))
