"""Interface of a format of text logs, and the checks that all formats share."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import ERROR, EXTENDED, FD, FD_LENGTHS, REMOTE, SECOND

_INT64_DIGITS: Final = 19
LATEST_NS: Final = 9_000_000_000_000_000_000
HEADER_LINES: Final = 100
"""Most lines before the first frame that count as a header, whatever they contain."""
CLASSIC_BYTES: Final = 8
MOST_DLC: Final = 15
FD_SIZES: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Number of data bytes by DLC."""
DLC_OF: Final = {size: code for code, size in enumerate(FD_SIZES)}


class Head(NamedTuple):
    """All fields of a frame's line except time and data.

    length: number of data bytes, -1 if the line does not give it. dlc: as in `Frame`. verdict: one
    without a frame if the line holds none.
    """

    can_id: int
    flags: int = 0
    length: int = -1
    channel: str = ""
    dlc: int = -1
    verdict: Verdict = Verdict.OK


class Line(NamedTuple):
    """A line that was parsed by itself. t_ns: its time as from `Format.times`, None without one.

    sure: whether the line is complete even if no line end follows.
    """

    verdict: Verdict
    head: Head | None = None
    t_ns: int | None = None
    data: bytes = b""
    sure: bool = False


class Format:
    """A format of lines, with the defaults that suit most formats."""

    regex: re.Pattern[str]
    """Matches every line. Groups: time, those of the head, data; the whole line if not plain."""
    order: tuple[int, ...] = ()
    """Positions of these groups in `regex`, if it has another order; else empty."""
    splits = False
    """Whether each word of the head is a group; else the head is one group."""
    shape: Any = None
    """Form of plain lines for dbc/text_read.c, see `dbc.logs.lines`; None: it cannot read them."""
    began = False
    """Whether a plain line came before the line that is passed to `line`."""
    has_names = False
    """Whether a line may hold further fields of its frame behind the data, such as the id."""
    notes: list[str]
    """Remarks for the user when the log has been read."""
    _headers = 0

    def learn(self, text: str) -> None:
        """Learn the names in these lines; called before `head` for any of them."""

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from the groups of the head."""
        raise NotImplementedError

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds from the groups of the time, by default in seconds. Raises ValueError."""
        return nanoseconds(texts)

    def data(self, text: str, length: int) -> bytes:
        """Bytes from the group of the data, by default of two digits each. Raises ValueError."""
        del length
        return bytes.fromhex(text)

    def whole(self, text: str) -> bool:
        """Whether no digit can be missing in the data's group, whose number of bytes is right."""
        del text
        return True

    def changes(self, text: str) -> bool:
        """Whether a line that is not plain changes how the lines behind it are read."""
        del text
        return False

    def line(self, text: str) -> Line:
        """Parse a line that is neither plain nor blank. A line of `changes` may replace `regex`.

        By default a line of unknown form: of the header, before the first frame; else malformed.
        """
        del text
        if self.began or self._headers >= HEADER_LINES:
            return Line(Verdict.MALFORMED)
        self._headers += 1
        return Line(Verdict.HEADER)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Frame times from the times in consecutive lines; lines not `timed` have a time of 0."""
        del timed
        return times

    def explain(self, text: str) -> str:
        """What is wrong with this line, and in which column; "" if nothing is known."""
        del text
        return ""


def nanoseconds(texts: Sequence[str], unit_ns: int = SECOND) -> NDArray[np.int64]:
    """Exact nanoseconds of decimal numbers in units of `unit_ns`; fractions of 1 ns are cut.

    Raises ValueError for a text that is not a number, or a number that is too large.
    """
    if not texts:
        return np.zeros(0, dtype=np.int64)
    places = {len(text) - text.find(".") - 1 if "." in text else 0 for text in texts}
    longest = max(map(len, texts))
    if len(places) == 1 and longest <= _INT64_DIGITS + 1:
        decimals = places.pop()
        digits = " ".join(texts).replace(".", "").split(" ")
        whole = np.array(list(map(int, digits)), dtype=np.int64)
        scale = 10**decimals
        if unit_ns % scale == 0 and np.abs(whole).max() <= LATEST_NS * scale // unit_ns:
            exact: NDArray[np.int64] = whole * (unit_ns // scale)
            return exact
    return np.array([_exact(text, unit_ns) for text in texts], dtype=np.int64)


def _exact(text: str, unit_ns: int) -> int:
    whole, _, fraction = text.strip().partition(".")
    sign = -1 if whole.startswith("-") else 1
    digits = f"{whole.lstrip('+-') or '0'}{fraction}"
    if len(digits) > 60 or not digits.isdecimal():
        raise ValueError(text)
    value: int = sign * (int(digits) * unit_ns // 10 ** len(fraction))
    if abs(value) > LATEST_NS:
        raise ValueError(text)
    return value


def words_of(text: str) -> list[str]:
    """Words between blanks and tabs, as in dbc/text_read.c: no other byte separates words."""
    return [word for word in text.replace("\t", " ").split(" ") if word]


def verdict_with(head: Head, data: bytes) -> Verdict:
    """Verdict of a line with this head and these data."""
    if head.verdict > Verdict.ERROR_FRAME:
        return head.verdict
    if len(data) != head.length and not (head.length < 0 and _possible(head.flags, len(data))):
        return Verdict.BAD_LENGTH
    return head.verdict


def _possible(flags: int, length: int) -> bool:
    return length in FD_LENGTHS if flags & FD else length <= CLASSIC_BYTES


def checked(head: Head) -> Head:
    """The head with its verdict: the kind of frame, or an impossible identifier or length."""
    if head.verdict > Verdict.ERROR_FRAME:
        return head
    if not 0 <= head.can_id <= (0x1FFF_FFFF if head.flags & (EXTENDED | ERROR) else 0x7FF):
        return head._replace(verdict=Verdict.BAD_ID)
    if not _possible(head.flags, max(head.length, 0)) or head.dlc > MOST_DLC:
        return head._replace(verdict=Verdict.BAD_LENGTH)
    return head._replace(verdict=verdict_of(head.flags))


def verdict_of(flags: int) -> Verdict:
    """Verdict of a frame with these flags."""
    for flag, verdict in (
        (ERROR, Verdict.ERROR_FRAME), (REMOTE, Verdict.REMOTE), (FD, Verdict.FD),
    ):  # fmt: skip
        if flags & flag:
            return verdict
    return Verdict.OK


def framed(head: Head, t_ns: int, data: bytes = b"", *, sure: bool = False) -> Line:
    """A line with a frame; its identifier and length are checked."""
    head = checked(head)
    return Line(verdict_with(head, data), head, t_ns, data, sure)
