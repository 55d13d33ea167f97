"""What a format of text logs is: its lines, and what is checked of every one of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import ERROR, EXTENDED, FD, FD_LENGTHS, REMOTE

_INT64_DIGITS: Final = 19
_LATEST_NS: Final = 9_000_000_000_000_000_000
CLASSIC_BYTES: Final = 8
MOST_DLC: Final = 15
FD_SIZES: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes by the code of the length."""


class Head(NamedTuple):
    """What a line says of a frame besides time and data.

    length: of its data; -1: as many as there are. dlc: as in `Frame`. verdict: other than those of
    frames if the line is none.
    """

    can_id: int
    flags: int = 0
    length: int = -1
    channel: str = ""
    dlc: int = -1
    verdict: Verdict = Verdict.OK


class Line(NamedTuple):
    """A line that was read by itself. t_ns: its time, if it has one; as `Format.times` has it.

    sure: that the line is whole, although no line end follows.
    """

    verdict: Verdict
    head: Head | None = None
    t_ns: int | None = None
    data: bytes = b""
    sure: bool = False


class Format:
    """A format of lines. What is not of its own in most formats stands here."""

    regex: re.Pattern[str]
    """Matches every line. Groups: time, those of the head, data; the line if it is not plain."""
    order: tuple[int, ...] = ()
    """Places of these groups among those of `regex`, if they are not in this order; else empty."""
    splits = False
    """Whether the head's groups are its words; else it is one group."""
    shape: Any = None
    """How plain lines look for dbc/text_read.c, see `dbc.logs.lines`; None: it cannot read them."""
    began = False
    """Whether a plain line came before the one that `line` is given."""
    has_names = False
    """Whether frames may have names, of which a line says behind its data what they are."""
    notes: list[str]
    """What a person is told when the log has been read."""

    def learn(self, text: str) -> None:
        """Names in these lines; before any of their heads is asked for."""

    def head(self, parts: tuple[str, ...]) -> Head:
        """Of the head's groups."""
        raise NotImplementedError

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds of the time's groups, seconds. Raises ValueError."""
        return nanoseconds(texts)

    def data(self, text: str, length: int) -> bytes:
        """Of the data's group, bytes of two digits each. Raises ValueError."""
        del length
        return bytes.fromhex(text)

    def whole(self, text: str) -> bool:
        """Whether no digit can follow in the data's group, which has as many bytes as it should."""
        del text
        return True

    def changes(self, text: str) -> bool:
        """Whether a line that is not plain says how those behind it are to be read."""
        del text
        return False

    def line(self, text: str) -> Line:
        """A line that is not plain. After one of `changes`, `regex` may be another one."""
        raise NotImplementedError

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """The frames' times of those that stand in consecutive lines; 0 in lines without one."""
        del timed
        return times

    def explain(self, text: str) -> str:
        """What is wrong with this line, and in which column; "" if nothing is known."""
        del text
        return ""


def nanoseconds(texts: Sequence[str], unit_ns: int = 1_000_000_000) -> NDArray[np.int64]:
    """Decimal numbers of a unit, exact. Raises ValueError for what is none or has no room.

    Beyond whole nanoseconds digits are cut.
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
        if unit_ns % scale == 0 and np.abs(whole).max() <= _LATEST_NS * scale // unit_ns:
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
    if abs(value) > _LATEST_NS:
        raise ValueError(text)
    return value


def words_of(text: str) -> list[str]:
    """Words between blanks and tabs, as dbc/text_read.c parts them: no other byte is a blank."""
    return [word for word in text.replace("\t", " ").split(" ") if word]


def verdict_with(head: Head, data: bytes) -> Verdict:
    """Of a line with this head and these data."""
    if head.verdict > Verdict.ERROR_FRAME:
        return head.verdict
    if len(data) != head.length and not (head.length < 0 and _possible(head.flags, len(data))):
        return Verdict.BAD_LENGTH
    return head.verdict


def _possible(flags: int, length: int) -> bool:
    return length in FD_LENGTHS if flags & FD else length <= CLASSIC_BYTES


def checked(head: Head) -> Head:
    """With a verdict of its own if no frame has this identifier, or this length."""
    if head.verdict > Verdict.ERROR_FRAME:
        return head
    if not 0 <= head.can_id <= (0x1FFF_FFFF if head.flags & (EXTENDED | ERROR) else 0x7FF):
        return head._replace(verdict=Verdict.BAD_ID)
    if not _possible(head.flags, max(head.length, 0)) or head.dlc > MOST_DLC:
        return head._replace(verdict=Verdict.BAD_LENGTH)
    return head._replace(verdict=verdict_of(head.flags))


def verdict_of(flags: int) -> Verdict:
    """Of a frame with these flags."""
    for flag, verdict in (
        (ERROR, Verdict.ERROR_FRAME), (REMOTE, Verdict.REMOTE), (FD, Verdict.FD),
    ):  # fmt: skip
        if flags & flag:
            return verdict
    return Verdict.OK


def framed(head: Head, t_ns: int, data: bytes = b"", *, sure: bool = False) -> Line:
    """A line with a frame, checked."""
    head = checked(head)
    return Line(verdict_with(head, data), head, t_ns, data, sure)
