"""Screen output of candump, with times: ` (1684144800.123456)  can0  123   [2]  01 02`.

The form is that of can-utils' lib.c: an identifier of eight digits has 29 bits, a length of two
digits means CAN FD, `{9}` (`-8`) is a raw length. Behind the channel may follow `RX B E` (`-x`):
direction, BRS, ESI; at the end `remote request`, `ERRORFRAME`, or the bytes as text (`-a`).

Times: seconds since 1970 (`-ta`, ten digits), dates (`-tA`), since the start (`-tz`) or since the
frame before (`-td`). The last two look alike, but only differences fall as often as they rise.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import DROPS, Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX
from dbc.logs.format import CLASSIC_BYTES, Format, Head, Line, nanoseconds
from dbc.logs.times import Differences, date_ns

SINCE_START: Final = "times are since the start of the log (candump -tz); none of them is a date"
DIFFERENCES: Final = "times are differences (candump -td): they are added up from 0"
LOCAL: Final = "times are dates without a zone (candump -tA): read as UTC"
_DATE: Final = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.(?:\d{9}|\d{6})"
_STAMP: Final = rf"(?:\d{{1,10}}\.(?:\d{{9}}|\d{{6}})|{_DATE})"
_FRAME: Final = (
    r"(\S{1,21})(?:[ \t]+(RX|TX)[ \t]+([B-])[ \t]+([E-]))?"
    r"[ \t]+([0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})[ \t]+(\[\d{1,2}\]|\{[0-9A-F]\})"
    r"((?:[ \t]+[0-9A-Fa-f]{2})*)(?:[ \t]+(remote request|ERRORFRAME))?(?:[ \t]+'[^\n]*')?[ \t]*"
)
_LINE: Final = re.compile(rf"^(?:[ \t]*\(({_STAMP})\)[ \t]+{_FRAME}|(.*))$", re.MULTILINE)
_SHOWN: Final = re.compile(rf"(?:\({_STAMP}\)[ \t]+)?{_FRAME}")
_TIME: Final = re.compile(rf"\(({_STAMP})\)")
_XL: Final = re.compile(rf"\({_STAMP}\)[ \t]+\S+.*\[\d{{4}}\][ \t]+\([0-9A-F]{{2}}\|.*")
_SINCE_1970: Final = 10
"""Digits of candump's seconds since 1970; seconds since the start have fewer digits."""
_ERROR_BIT: Final = 0x2000_0000
_MOST_BACK: Final = 0.1
"""Share of the span of all stamps: stamps that fall by more are differences. Times since the start
fall only if frames of several channels are not in order, and then by little."""


class Screen(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    regex = _LINE
    order = (0, 1, 2, 3, 4, 5, 6, 8, 7, 9)

    def __init__(self, lines: Sequence[str] = ()) -> None:
        """lines: the first lines of the log, by which differences are recognised."""
        self.notes: list[str] = []
        self._from_start = False
        self._differences = Differences() if _are_differences(_stamps_of(lines)) else None

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds of seconds with a point, or of dates."""
        if not texts:
            return np.zeros(0, dtype=np.int64)
        if "-" in texts[0]:
            self._note(LOCAL)
            return np.array([date_ns(text) for text in texts], dtype=np.int64)
        self._from_start = texts[0].index(".") < _SINCE_1970
        return nanoseconds(texts)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times as they are; differences are summed."""
        if not self._from_start:
            return times
        self._note(DIFFERENCES if self._differences else SINCE_START)
        return self._differences.continued(times, timed) if self._differences else times

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `channel direction brs esi id length kind`; absent ones are empty."""
        channel, direction, brs, esi, digits, length, kind = parts
        number, long = int(digits, 16), len(digits) == len("00000123")
        flags = TX if direction == "TX" else 0
        if long and number & _ERROR_BIT:
            number, flags = number & ~_ERROR_BIT, flags | ERROR
        elif long:
            flags |= EXTENDED
        raw = length[0] == "{"
        size = int(length[1:-1], 16 if raw else 10)
        if kind == "remote request":
            return Head(number, flags | REMOTE, 0, channel, size or -1)
        if (kind == "ERRORFRAME") != bool(flags & ERROR) and kind:
            return Head(0, verdict=Verdict.MALFORMED)
        if len(length) == len("[08]"):
            flags |= FD | (BRS if brs == "B" else 0) | (ESI if esi == "E" else 0)
        if raw and size > CLASSIC_BYTES:
            return Head(number, flags, CLASSIC_BYTES, channel, size)
        # Behind `[0]`, `remote request` may have been cut off: such a last line is incomplete.
        return Head(number, flags, size if size or flags & FD else -1, channel)

    def line(self, text: str) -> Line:
        """Parse any other line: a CAN XL frame, a count of lost frames, shell output before."""
        is_detail = text.startswith("\t")  # of the error frame in the line before (-e)
        text = text.strip()
        if is_detail or text.startswith(("#", ";", "//")):
            return Line(Verdict.COMMENT)
        if stamp := _TIME.match(text):
            # The time is kept, because the next one may be relative to it.
            verdict = Verdict.XL if _XL.fullmatch(text) else Verdict.MALFORMED
            return Line(verdict, None, _stamp_ns(stamp[1]))
        if DROPS.fullmatch(text.encode("latin-1", "replace")):
            return Line(Verdict.DROPCOUNT)
        return Line(Verdict.MALFORMED) if text.startswith("(") else super().line(text)


def _stamp_ns(text: str) -> int | None:
    try:
        return date_ns(text) if "-" in text else nanoseconds([text]).item()
    except (ValueError, OverflowError):
        return None


def _stamps_of(lines: Sequence[str]) -> NDArray[np.int64]:
    """Stamps in these lines that count from the start or from the frame before."""
    found = [match[1] for line in lines if (match := _TIME.match(line.strip()))]
    early = [text for text in found if "-" not in text and text.index(".") < _SINCE_1970]
    return nanoseconds(early)


def _are_differences(stamps: NDArray[np.int64]) -> bool:
    """Whether stamps are differences: they fall far enough, or are all the same."""
    # The first stamp may be 0 in both cases.
    later = stamps[1:]
    if later.size < 2:
        return bool((np.diff(stamps) < 0).any())
    back, span = -np.diff(later).min(), np.ptp(later)
    alike = span == 0 and later.item(0) > 0
    return bool(alike or back > _MOST_BACK * span)


def is_screen_form(text: str) -> bool:
    """Whether a line has the form of candump's screen output, with or without a time."""
    return _SHOWN.fullmatch(text.strip()) is not None
