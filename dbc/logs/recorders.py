"""Text logs of recorders whose lines a pattern cannot describe: CanKing, CARBUS Analyzer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import ERROR, EXTENDED, REMOTE, SECOND, TX
from dbc.logs.format import Format, Head, Line, framed, nanoseconds
from dbc.logs.times import DayTimes

_CANKING: Final = re.compile(
    r"^(?:[ \t]*(\d{1,3})[ \t]+([0-9A-Fa-f]{8})(?:[ \t]+([A-Z]+))?[ \t]+(\d{1,2})"
    r"((?:[ \t]+[0-9A-Fa-f]{2})*)[ \t]+(\d+\.\d+)[ \t]+([RT])[ \t]*|(.*))$",
    re.MULTILINE,
)
_CANKING_ERROR: Final = re.compile(r"(\d{1,3})\s+[0-9A-Fa-f]{8}\s+ErrorFrame\s+(\d+\.\d+)\s+([RT])")
_CANKING_FLAGS: Final = {"": 0, "X": EXTENDED, "R": REMOTE, "XR": EXTENDED | REMOTE}
_CANKING_NOTES: Final = ("Chn ", "Logging ", "***")
_CARBUS: Final = re.compile(
    r"^(?:(\d+[,.]\d+)\t(\d{1,3})\t([0-9A-Fa-f]{4,8})\t([0-9A-Fa-f]{1,8})\t(\d{1,2})"
    r"\t([0-9A-Fa-f ]*)\t.*|(.*))$",
    re.MULTILINE,
)
_CARBUS_FLAGS: Final = {0: 0, 1: EXTENDED}
_CARBUS_ALWAYS: Final = 4


class CanKing(Format):
    """Kvaser's CanKing, with hexadecimal numbers: the time and the direction follow the data.

    Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir
     0    00000181 X       2  01  02                                1.500000 R
    """

    regex = _CANKING
    order = (5, 0, 1, 2, 3, 6, 4, 7)
    has_names = True
    """An unterminated last line may always be incomplete."""

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `channel id flags length direction`."""
        channel, digits, letters, length, direction = parts
        flags = _CANKING_FLAGS.get(letters)
        if flags is None:
            return Head(0, verdict=Verdict.MALFORMED)
        flags |= TX if direction == "T" else 0
        number, size = int(digits, 16), int(length)
        if flags & REMOTE:
            return Head(number, flags, 0, channel, size or -1)
        return Head(number, flags, size, channel)

    def line(self, text: str) -> Line:
        """Parse an error frame, a heading, or what CanKing notes when logging stops."""
        text = text.strip()
        if error := _CANKING_ERROR.fullmatch(text):
            flags = ERROR | (TX if error[3] == "T" else 0)
            t_ns = nanoseconds([error[2]]).item()
            return framed(Head(0, flags, 0, error[1]), t_ns, sure=True)
        return Line(Verdict.COMMENT) if text.startswith(_CANKING_NOTES) else super().line(text)

    def explain(self, text: str) -> str:
        """What a line may lack, in the words of CanKing."""
        del text
        return "not a frame with hexadecimal numbers, of CAN 2.0"


class Carbus(Format):
    r"""CARBUS Analyzer (canhacker.ru): `14,687\t1\t0004\t4E0\t2\t24 00\t00000000\t$ \t`.

    Behind the channel are flags, of which bit 0 marks 29 bits; behind the data a mask, and the
    bytes as text. Lines end in CR only. Times are the seconds of a minute.
    """

    regex = _CARBUS
    splits = True

    def __init__(self) -> None:
        self._times = DayTimes(60 * SECOND)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times that continue behind the end of a minute."""
        return self._times.continued(times, timed)

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds of seconds with a comma."""
        return nanoseconds([text.replace(",", ".") for text in texts])

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `channel flags id length`."""
        channel, bits, digits, length = parts
        flags = _CARBUS_FLAGS.get(int(bits, 16) & ~_CARBUS_ALWAYS)
        if flags is None:
            return Head(0, verdict=Verdict.MALFORMED)
        return Head(int(digits, 16), flags, int(length), channel)

    def line(self, text: str) -> Line:
        """Parse a line without a frame: the first one, or a comment."""
        return Line(Verdict.COMMENT) if text.startswith(("@", "#")) else super().line(text)
