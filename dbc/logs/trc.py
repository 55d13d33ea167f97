"""PEAK's TRC, versions 1.0 to 1.3, 2.0 and 2.1: the format of its lines.

This module exists because python-can's reader does not know version 1.2, stops at PEAK's own
sample, and drops error, status and short lines without a message (docs/upstream/trc.md).
`$STARTTIME` is on the clock of the recording machine, without a time zone: it is read as UTC.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, TX
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES, Format, Head, Line, framed, nanoseconds
from dbc.logs.lines import shape_of
from dbc.logs.times import DAY_NS

EPOCH_DAYS: Final = 25_569
"""Days from 30 December 1899, the origin of `$STARTTIME`, to 1970."""
_VERSIONS: Final = {
    "1.0": "O I L D", "1.1": "O T I L D", "1.2": "O B T I L D", "1.3": "O B T I R L D",
    "2.0": "O T I d L D", "2.1": "O T B I d R L D",
}  # fmt: skip
"""Columns behind the number, named as in `$COLUMNS`; in 1.x, T is Rx, Tx, Error or Warng."""
_FORMS: Final = {
    "T": r"([RrTt]x|DT|F[DBE]|BI)",
    "I": r"([0-9A-Fa-f]{4,8})",
    "L": r"(\d{1,4})",
    "l": r"(\d{1,4})",
}
_WORD: Final = r"([^ \t\n]+)"
_BLANK: Final = r"[ \t]+"
_TYPES: Final = {
    "DT": 0, "FD": FD, "FB": FD | BRS, "FE": FD | BRS | ESI, "BI": FD | ESI, "RR": REMOTE,
    "RX": 0, "TX": TX,
}  # fmt: skip
_ERRORS, _STATES = frozenset({"ER", "ERROR"}), frozenset({"ST", "EC", "EV", "WARNG"})
_NO_ID: Final = re.compile(r"[^0-9A-Fa-f]|^.{0,3}$|.{9}")
_ZERO: Final = "FFFFFFFF"
"""The identifier of a status line of version 1.0."""
_LINE: Final = re.compile(r"\d+\)?[ \t]+\S")
BARE: Final = re.compile(r"\s*\d+(?:\)|\s+-?\d+\.\d+\s+(?:DT|F[DBE]|BI|RR|ER|ST|EC|EV)\s)")
"""Start of a line of 1.x or 2.x, as no other recorder writes it."""
_KEY: Final = re.compile(r";\$(\w+)=([^;]*)")


class Trc(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    splits = True

    def __init__(self, lines: Sequence[str] = ()) -> None:
        """Start as for a log without a header. lines: the first ones; they show its version."""
        self._start_ns = 0
        self._columns: list[str] = []
        self._bare = max(_VERSIONS, key=lambda version: self._fitting(version, lines))
        self._set(self._bare)

    def _fitting(self, version: str, lines: Sequence[str]) -> int:
        """Number of lines with the columns of a version."""
        self._set(version)
        return sum(self.regex.match(line)[1] is not None for line in lines)  # type: ignore[index]

    def _set(self, version: str, columns: Sequence[str] = ()) -> None:
        """Set the columns of the lines. Raises KeyError for unknown versions or column sets."""
        self._columns = list(columns or _VERSIONS[version].split())
        names = self._columns
        if names[-1] != "D" or not {"O", "I"} <= set(names) or not {"L", "l"} & set(names):
            raise KeyError(version)
        head = [_FORMS.get(c, _WORD) for c in names[:-1] if c != "O"]
        at = names.index("O")
        head.insert(at, r"(-?\d+(?:[.,]\d*)?)")
        plain = r"[ \t]*\d+\)?" + _BLANK + _BLANK.join(head) + r"(?![^ \t\n])([ \t0-9A-Fa-f]*)"
        self.regex = re.compile(rf"^(?:{plain}|(.*))$", re.MULTILINE)
        count = len(head)
        rest = [k for k in range(count) if k != at]
        self.order = (at, *rest, count, count + 1) if at else ()
        self._head = [c for c in names[:-1] if c != "O"]
        self.shape = shape_of(MS, 1, len(self._head)) if names[0] == "O" else None

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds of times in milliseconds. Raises ValueError."""
        return nanoseconds([text.replace(",", ".") for text in texts], MS)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times since 1970, from those since the start of the log."""
        if self._bare and timed.any():
            self.notes.append(f"there is no $FILEVERSION: read as {self._bare}, with times in ms")
            self._bare = ""
        return times + self._start_ns

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head of a plain line."""
        return self._of(dict(zip(self._head, parts, strict=True)))

    def _of(self, parts: dict[str, str]) -> Head:
        kind, name = parts.get("T", "Rx").upper(), parts["I"]
        code_text = parts["L"] if "L" in parts else parts["l"]
        if not code_text.isdecimal() or _NO_ID.search(name):
            return Head(0, verdict=Verdict.MALFORMED)
        if kind in _STATES or (name.upper() == _ZERO and "T" not in parts):
            return Head(0, verdict=Verdict.EVENT)
        bus = parts.get("B", "1")
        channel = str(max(int(bus) - 1, 0)) if bus.isdecimal() else bus
        sent = TX if parts.get("d", parts.get("R", "")).upper() == "TX" else 0
        if kind in _ERRORS:
            return Head(0, ERROR | sent, 0, channel, verdict=Verdict.ERROR_FRAME)
        if kind not in _TYPES:
            return Head(0, verdict=Verdict.MALFORMED)
        flags = _TYPES[kind] | sent | (EXTENDED if len(name) > 4 else 0)
        code = int(code_text)
        if flags & FD and "L" in parts:
            size = FD_SIZES[code] if code < len(FD_SIZES) else -1
        else:
            size = code if code <= 64 else -1
        raw = -1
        if (
            not flags & FD
            and "L" in parts
            and "B" in parts
            and CLASSIC_BYTES < code < len(FD_SIZES)
        ):
            raw, size = code, CLASSIC_BYTES
        if size < 0:
            return Head(0, verdict=Verdict.BAD_LENGTH)
        if flags & REMOTE:
            return Head(int(name, 16), flags, 0, channel, code or -1)
        return Head(int(name, 16), flags, size, channel, raw)

    def changes(self, text: str) -> bool:
        """True for a line `;$KEY=value`."""
        return _KEY.match(text.strip()) is not None

    def line(self, text: str) -> Line:
        """Parse a header, a comment, a remote or error frame, or a state."""
        text = text.strip()
        if match := _KEY.match(text):
            return Line(self._key(match[1].upper(), match[2].strip()))
        if text.startswith(";"):
            return Line(Verdict.COMMENT)
        words = text.split()
        names = self._columns[:-1]
        parts = dict(zip(names, words[1:], strict=False))
        body = words[1 + len(names) :]
        state = parts.get("T", "").upper() in _STATES
        if not _LINE.match(text) or (len(parts) < len(names) and not state):
            return Line(Verdict.MALFORMED)
        try:
            t_ns = self.times([parts["O"]]).item()
            if state:
                return Line(Verdict.EVENT, None, t_ns)
            if parts.get("T", "").upper() in _ERRORS or body[:1] == ["ERROR"]:
                return framed(self._of(parts | {"I": "0000", "T": "ERROR"}), t_ns, sure=True)
            head = self._of(parts)
            if head.verdict is Verdict.EVENT:
                return Line(Verdict.EVENT, None, t_ns)
            if body[:1] == ["RTR"]:
                asked = head.dlc if head.dlc >= 0 else head.length
                head = head._replace(flags=head.flags | REMOTE, length=0, dlc=asked or -1)
                return framed(head, t_ns, sure=True)
            return framed(head, t_ns, bytes.fromhex(" ".join(body)), sure=True)
        except (KeyError, ValueError, OverflowError):
            return Line(Verdict.MALFORMED)

    def _key(self, key: str, value: str) -> Verdict:
        """Apply `;$KEY=value` of the header."""
        try:
            self._bare = ""
            if key == "FILEVERSION":
                self._set(value)
            elif key == "STARTTIME":
                since_1899 = nanoseconds([value.replace(",", ".")], DAY_NS).item()
                self._start_ns = round(since_1899, -3) - EPOCH_DAYS * DAY_NS
            elif key == "COLUMNS":
                self._set("", [name.strip() for name in value.split(",")][1:])
        except (ValueError, KeyError, OverflowError):
            return Verdict.MALFORMED
        return Verdict.HEADER
