"""Logs whose lines a pattern describes: `{ms:x} {id:x} {data}`.

Text outside braces must occur in the line as it is; a blank stands for one or more blanks and tabs.
Fields:

    {s} {ms} {us} {ns}  time, decimal, with a point or (if no comma follows in the pattern) a
                        comma; `:x` hexadecimal whole number, `:x8` with eight digits
    {clock} {date}      time of day, `22:20:14.992`; ISO 8601, UTC if no zone is given
    {id} {id:d}         identifier, hexadecimal or decimal, `:x8` with eight digits; 29 bits from
                        800 (hexadecimal) on, or if an x follows
    {type}              s, x, 11, 29, R11, T29: 11 or 29 bits; r in sr and xr: remote; s-fd, x-fd:
                        CAN FD
    {channel} {dlc}
    {dir}               sent if it begins with T, as in Tx
    {brs} {esi}         flags of CAN FD: B and E, or 1; if not set - or 0
    {data} {data:d}     bytes, hexadecimal or decimal; blanks and one of , ; : . - between them
    {skip}              one word

If a pattern ends in {data}, nothing may follow in the line. If it ends otherwise, more text may
follow.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ESI, EXTENDED, FD, MS, REMOTE, SECOND, TX
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES, Format, Head, Line, nanoseconds
from dbc.logs.times import DAY_NS, DayTimes, clock_ns, date_ns

_FIELD: Final = re.compile(r"\{(\w+)(?::([xd])(\d{1,2})?)?\}")
_UNITS: Final = {"s": SECOND, "ms": MS, "us": 1000, "ns": 1, "clock": SECOND, "date": SECOND}
_NUMBER: Final = r"-?\d+(?:\.\d*)?"
_BYTES: Final = r"[0-9A-Fa-f \t,;:.\-]"
_FORMS: Final = {
    "s": _NUMBER, "ms": _NUMBER, "us": _NUMBER, "ns": r"-?\d+",
    "clock": r"\d{1,2}:\d{1,2}:\d{1,2}(?:[.:,]\d{1,9})?",
    "date": r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d{1,9})?(?:Z|[+-]\d\d:?\d\d)?",
    "id": r"(?:0[xX])?[0-9A-Fa-f]{1,8}[xXhH]?", "type": r"[A-Za-z0-9]{1,4}(?:-fd)?",
    "channel": r"[^\s,;]{1,21}", "dir": r"[A-Za-z]{1,4}", "dlc": r"[0-9A-Fa-f]{1,2}",
    "brs": "[B10-]", "esi": "[E10-]",
    "data": rf"{_BYTES}*(?:(?<=(?<![0-9A-Fa-f])0)[xX](?=[0-9A-Fa-f]){_BYTES}*)*",
    "skip": r"[^\s,;]+",
}  # fmt: skip
_CLEAN: Final = re.compile(r"0[xX]")
_NUMBER_OR_COMMA: Final = r"(-?\d+(?:[.,]\d*)?)"
_TOKEN: Final = re.compile(r"[0-9A-Fa-f]+")
_WORD: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]+)")
_MISSING: Final = re.compile(r"[,;:.\-][ \t]*[,;:.\-][ \t,;:.\-]*(?=[0-9A-Fa-f])")
"""Two separators without a byte between them, and a byte behind them."""
COMMENT: Final = ("#", ";", "//", "***")


class PatternError(ValueError):
    """A pattern that cannot be used; the message gives the place and the reason."""


class _Field(NamedTuple):
    name: str
    base: int
    form: str


class Pattern(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    clock_end_ns = DAY_NS
    """Limit of `{clock}`: a time of day is earlier."""

    def __init__(self, pattern: str) -> None:
        """Compile the pattern. Raises PatternError."""
        self._day_times = DayTimes()
        self._compile(pattern)

    def _compile(self, pattern: str) -> None:
        """Read the lines that follow by this pattern. Raises PatternError."""
        self.pattern = pattern
        parts = _parts(pattern)
        fields = [part for part in parts if isinstance(part, _Field)]
        names = [field.name for field in fields if field.name != "skip"]
        times = [name for name in names if name in _UNITS]
        for name in names:
            if names.count(name) > 1:
                raise PatternError(f"{{{name}}} is given twice in {pattern!r}")
        if len(times) != 1 or "id" not in names or "data" not in names:
            needed = "one time ({s}, {ms}, {us}, {ns}, {clock} or {date}), one {id} and one {data}"
            raise PatternError(f"{pattern!r} needs {needed}")
        self._time = next(field for field in fields if field.name in _UNITS)
        self._bases = {field.name: field.base for field in fields}
        behind_it = [*parts[1:], ""]
        self._pieces = [_regex(p, n) for p, n in zip(parts, behind_it, strict=True)]
        plain = r"[ \t]*" + "".join(self._pieces)
        ends_in_data = isinstance(parts[-1], _Field) and parts[-1].name == "data"
        tail = "" if ends_in_data else ".*"
        self.regex = re.compile(rf"^(?:{plain}{tail}|(.*))$", re.MULTILINE)
        self._head = [name for name in names if name not in _UNITS and name != "data"]
        places = [names.index(self._time.name), *(names.index(name) for name in self._head),
                  names.index("data"), len(names)]  # fmt: skip
        self.order = () if places == sorted(places) else tuple(places)
        self._parts = parts

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds, by the unit of the pattern's time. Raises ValueError."""
        unit = _UNITS[self._time.name]
        if self._time.name == "clock":
            times = np.array([clock_ns(text) for text in texts], dtype=np.int64)
            if times.size and times.max() >= self.clock_end_ns:
                raise ValueError(texts)
            return times
        if self._time.name == "date":
            return np.array([date_ns(text) for text in texts], dtype=np.int64)
        if self._time.base == 16:
            return nanoseconds([str(int(text, 16)) for text in texts], unit)
        return nanoseconds([text.replace(",", ".") for text in texts], unit)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times as they are; times of day continue past midnight."""
        return self._day_times.continued(times, timed) if self._time.name == "clock" else times

    def data(self, text: str, length: int) -> bytes:
        """Bytes with separators between them. Raises ValueError, also if a byte is missing."""
        del length
        decimal = self._bases["data"] == 10
        try:
            return bytes(map(int, text.split())) if decimal else bytes.fromhex(text)
        except ValueError:
            if _MISSING.search(text):
                raise
        words = _TOKEN.findall(_CLEAN.sub("", text))
        return b"".join(_byte(word, decimal=decimal) for word in words)

    def whole(self, text: str) -> bool:
        """False if the last byte may be cut: fewer than two hexadecimal or three decimal digits."""
        last = _TOKEN.findall(_CLEAN.sub("", text))[-1:] or [""]
        if self._bases["data"] == 10:
            return len(last[0]) == len("255")
        return len(last[0]) % 2 == 0

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from the fields other than time and data."""
        found = dict(zip(self._head, parts, strict=True))
        digits = found["id"].rstrip("xXhH") if self._bases["id"] == 16 else found["id"]
        try:
            number = int(digits or "0", self._bases["id"])
            code = int(found["dlc"], self._bases["dlc"]) if "dlc" in found else -1
        except ValueError:
            return Head(0, verdict=Verdict.MALFORMED)
        kind = found.get("type", "").lower()
        flags = EXTENDED if number > 0x7FF or found["id"][-1] in "xX" or "29" in kind else 0
        flags |= EXTENDED if kind.startswith(("x", "ext", "eff")) else 0
        flags |= TX if found.get("dir", "")[:1] in "Tt" and "dir" in found else 0
        if kind in ("sr", "xr"):
            flags |= REMOTE
        size = (
            FD_SIZES[code]
            if CLASSIC_BYTES < code < len(FD_SIZES) and self._bases["dlc"] == 16
            else code
        )
        if size > CLASSIC_BYTES or kind.endswith("-fd"):
            flags |= FD
        flags |= FD | BRS if found.get("brs", "") in ("B", "1") else 0
        flags |= FD | ESI if found.get("esi", "") in ("E", "1") else 0
        # candump shows the length of a CAN FD frame with two digits.
        flags |= FD if "brs" in found and len(found.get("dlc", "")) == len("08") else 0
        channel = found.get("channel", "")
        if flags & REMOTE:
            return Head(number, flags, 0, channel, code if code > 0 else -1)
        return Head(number, flags, size, channel)

    def line(self, text: str) -> Line:
        """Parse a line that does not match the pattern: blank, comment, header or malformed."""
        text = text.strip()
        if text.startswith(COMMENT):
            return Line(Verdict.COMMENT)
        return super().line(text)

    def explain(self, text: str) -> str:
        """Message with the column from which a line does not match the pattern; else empty."""
        if (match := self.regex.match(text)) and match[self.regex.groups] is None:
            at, wanted = self._wrong_value(match)
        else:
            at, wanted = self._end_of_match(text)
        if at < 0:
            return ""
        found = text[at : at + 12].strip()
        return f"column {at + 1}: {wanted} expected, {repr(found) if found else 'nothing'} found"

    def matched_columns(self, text: str) -> int:
        """Number of characters of a line that the pattern matches."""
        return self._end_of_match(text)[0]

    def _wrong_value(self, match: re.Match[str]) -> tuple[int, str]:
        """Position of an invalid time or byte in a matching line, -1 if none, and its field."""
        group = (self.order[0] if self.order else 0) + 1
        try:
            self.times([match[group]])
        except (ValueError, OverflowError):
            return match.start(group), f"{{{self._time.name}}}"
        return self._wrong_byte(match), "a byte of {data}"

    def _wrong_byte(self, match: re.Match[str]) -> int:
        group = (self.order[-2] if self.order else self.regex.groups - 2) + 1
        start, decimal = match.start(group), self._bases["data"] == 10
        for word in _WORD.finditer(match[group]):
            try:
                _byte(word[1], decimal=decimal)
            except ValueError:
                return start + word.start()
        missing = _MISSING.search(match[group])
        return start + missing.start() + 1 if missing else -1

    def _end_of_match(self, text: str) -> tuple[int, str]:
        """Position up to which the pattern matches a line, and the part expected there."""
        at, k = 0, 0
        for k in range(len(self._pieces) + 1):
            match = re.match(r"[ \t]*" + "".join(self._pieces[:k]), text)
            if match is None:
                break
            at = match.end()
        else:
            return at, "a byte of {data}, or the end of the line,"
        part = self._parts[k - 1]
        return at, f"{{{part.name}}}" if isinstance(part, _Field) else repr(part)


def _byte(word: str, *, decimal: bool) -> bytes:
    """One byte, or several in hexadecimal. Raises ValueError."""
    if decimal:
        return bytes([int(word)])
    return bytes.fromhex(word if len(word) > 1 else f"0{word}")


def _parts(pattern: str) -> list[_Field | str]:
    """Fields of a pattern and the texts between them. Raises PatternError."""
    parts: list[_Field | str] = []
    at = 0
    for match in _FIELD.finditer(pattern):
        if match.start() > at:
            parts.append(pattern[at : match.start()])
        name, base, width = match.groups()
        if name not in _FORMS:
            known = ", ".join(f"{{{known}}}" for known in _FORMS)
            raise PatternError(f"{{{name}}} in {pattern!r} is no field; there are {known}")
        hexadecimal = base == "x" or (base is None and name in ("id", "data"))
        form = _FORMS[name]
        if base == "x" and name in _UNITS:
            form = r"[0-9A-Fa-f]{1,15}"
        if base == "d" and name == "id":
            form = r"\d{1,10}"
        if width is not None and name != "data":
            digit = r"[0-9A-Fa-f]" if hexadecimal else r"\d"
            form = f"{digit}{{{width}}}"
        parts.append(_Field(name, 16 if hexadecimal else 10, form))
        at = match.end()
    if pattern[at:]:
        parts.append(pattern[at:])
    for part in parts:
        if isinstance(part, str) and ("{" in part or "}" in part):
            raise PatternError(f"{part.strip()!r} in {pattern!r} is no field")
    return parts or [""]


def _regex(part: _Field | str, following: _Field | str) -> str:
    """Regular expression of a part; the blank before {data} may be missing if there are no data."""
    if isinstance(part, _Field):
        if part.form == _NUMBER and not str(following).startswith(","):
            return _NUMBER_OR_COMMA
        return f"(?:{part.form})" if part.name == "skip" else f"({part.form})"
    pieces = [r"[ \t]+" if piece.isspace() else re.escape(piece)
              for piece in re.split(r"(\s+)", part) if piece]  # fmt: skip
    if part[-1:].isspace() and isinstance(following, _Field) and following.name == "data":
        pieces[-1] = r"(?:[ \t]+|(?=\n|$))"
    return "".join(pieces)
