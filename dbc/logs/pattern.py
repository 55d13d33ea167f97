"""Logs of any line that a pattern describes: `{ms:x} {id:x} {data}`.

What stands outside of braces stands so in the line; a blank is any number of blanks and tabs, at
least one. Fields:

    {s} {ms} {us} {ns}  time, decimal; `:x` whole hexadecimal, `:x8` of eight digits
    {clock} {date}      time of day, `22:20:14.992`; ISO 8601, UTC where no zone is named
    {id} {id:d}         identifier, hexadecimal or decimal, `:x8` of eight digits; 29 bits from 800
                        on, or with an x behind it
    {type}              s, x, 11, 29, R11, T29: 11 or 29 bits; r in sr and xr: remote
    {channel} {dlc}
    {dir}               sent where it begins with T, as Tx does
    {data} {data:d}     bytes, hexadecimal or decimal, with anything between them
    {skip}              one word; what comes behind the last field does not matter
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import EXTENDED, FD, MS, REMOTE, SECOND, TX
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES, Head, Line, nanoseconds

HEADER_LINES: Final = 100
"""Lines before the first frame that may say anything."""
_FIELD: Final = re.compile(r"\{(\w+)(?::([xd])(\d{1,2})?)?\}")
_UNITS: Final = {"s": SECOND, "ms": MS, "us": 1000, "ns": 1, "clock": SECOND, "date": SECOND}
_FORMS: Final = {
    "s": r"-?\d+(?:\.\d*)?", "ms": r"-?\d+(?:\.\d*)?", "us": r"-?\d+(?:\.\d*)?", "ns": r"-?\d+",
    "clock": r"\d{1,2}:\d\d:\d\d(?:[.:,]\d{1,9})?",
    "date": r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d{1,9})?(?:Z|[+-]\d\d:?\d\d)?",
    "id": r"(?:0[xX])?[0-9A-Fa-f]{1,8}[xXhH]?", "type": r"[A-Za-z0-9]{1,4}",
    "channel": r"[^\s,;]{1,21}", "dir": r"[A-Za-z]{1,4}", "dlc": r"[0-9A-Fa-f]{1,2}",
    "data": r"[0-9A-Fa-fxX \t,;:.\-]*", "skip": r"[^\s,;]+",
}  # fmt: skip
_CLEAN: Final = re.compile(r"0[xX]")
_TOKEN: Final = re.compile(r"[0-9A-Fa-f]+")
_COMMENT: Final = ("#", ";", "//", "***")
_NOTE: Final = re.compile(r"\d+\.\d+ +\d?C[A-Z]{2}\b")
"""CRTD's lines that are none of a frame."""
DIALECTS: Final = {
    "Cascadia Motion": "{ms:x8}x{id:x8}{data}",
    "CRTD": "{s} {type} {id} {data}",
    "Microchip CAN BUS Analyzer": "{ms};{dir};{id};{dlc};{data}",
    "BusMaster": "{clock} {dir} {channel} {id} {type} {dlc} {data}",
    "candump on a screen, with times": "({s}) {channel} {id} [{dlc}] {data}",
    "GVRET": "{us} - {id} {type} {channel} {dlc} {data}",
}
"""Formats that are recognised by their lines."""
GUESSES: Final = (
    *DIALECTS.values(),
    "{s} {id} {dir} {dlc} {data}", "{s} {channel} {id} {dir} {dlc} {data}",
    "{s} {id} {dlc} {data}", "{s} {channel} {id} {dlc} {data}", "{s} {id} {data}",
    "{s} {channel} {id} {data}", "{s} {id}#{data}", "{s} {channel} {id}#{data}",
    "{s},{id},{dlc},{data}", "{s},{channel},{id},{dlc},{data}", "{s},{id},{data}",
    "{s};{id};{dlc};{data}", "{s};{channel};{id};{dlc};{data}", "{s};{id};{data}",
    "[{s}] {channel} {id} {dlc} {data}", "[{s}] {id} {dlc} {data}", "[{s}] {id} {data}",
    "[{clock}] {id} {data}", "{clock} {channel} {id} {dlc} {data}", "{clock} {id} {dlc} {data}",
    "{clock} {id} {data}", "{date} {channel} {id} {dlc} {data}", "{date} {id} {dlc} {data}",
    "{date} {id} {data}", "{date},{id},{dlc},{data}", "{date},{id},{data}",
    "{ms:x} {id:x} {data}", "{ms:x},{id:x},{data}", "{ms:x8}{id:x8}{data}",
)  # fmt: skip
"""What `--line auto` tries, in this order among those that match equally many lines."""


class PatternError(ValueError):
    """A pattern that cannot be used; the text says where and why."""


class _Field(NamedTuple):
    name: str
    base: int
    form: str


class Pattern:
    """The lines of one log, see `dbc.logs.format.Format`."""

    began = False
    splits = False
    shape = None

    def __init__(self, pattern: str) -> None:
        """Raises PatternError."""
        self.pattern = pattern
        parts = _parts(pattern)
        fields = [part for part in parts if isinstance(part, _Field)]
        names = [field.name for field in fields if field.name != "skip"]
        times = [name for name in names if name in _UNITS]
        for name in names:
            if names.count(name) > 1:
                raise PatternError(f"{{{name}}} stands twice in {pattern!r}")
        if len(times) != 1 or "id" not in names or "data" not in names:
            needed = "one time ({s}, {ms}, {us}, {ns}, {clock} or {date}), one {id} and one {data}"
            raise PatternError(f"{pattern!r} needs {needed}")
        self._time = next(field for field in fields if field.name in _UNITS)
        self._bases = {field.name: field.base for field in fields}
        behind_it = [*parts[1:], ""]
        self._pieces = [_regex(p, n) for p, n in zip(parts, behind_it, strict=True)]
        plain = r"[ \t]*" + "".join(self._pieces)
        ends_in_data = isinstance(parts[-1], _Field) and parts[-1].name == "data"
        tail = r"(?![^\s]).*" if ends_in_data else ".*"
        self.regex = re.compile(rf"^(?:{plain}{tail}|(.*))$", re.MULTILINE)
        self._head = [name for name in names if name not in _UNITS and name != "data"]
        places = [names.index(self._time.name), *(names.index(name) for name in self._head),
                  names.index("data"), len(names)]  # fmt: skip
        self.order = () if places == sorted(places) else tuple(places)
        self._parts = parts
        self._headers = 0
        self._days = 0
        self._last_ns = 0

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """In the pattern's unit."""
        unit = _UNITS[self._time.name]
        if self._time.name == "clock":
            return self._of_day([_clock_ns(text) for text in texts])
        if self._time.name == "date":
            return np.array([_date_ns(text) for text in texts], dtype=np.int64)
        if self._time.base == 16:
            return np.array([int(text, 16) for text in texts], dtype=np.int64) * unit
        return nanoseconds(texts, unit)

    def _of_day(self, stamps: list[int]) -> NDArray[np.int64]:
        """Midnight is a step back by more than half a day."""
        for k, t_ns in enumerate(stamps):
            if t_ns < self._last_ns - 43_200 * SECOND:
                self._days += 1
            self._last_ns = t_ns
            stamps[k] = t_ns + self._days * 86_400 * SECOND
        return np.array(stamps, dtype=np.int64)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """As they are."""
        del timed
        return times

    def data(self, text: str, length: int) -> bytes:
        """Bytes with anything between them."""
        del length
        if self._bases["data"] == 10:
            return bytes(map(int, _TOKEN.findall(text)))
        try:
            return bytes.fromhex(text)
        except ValueError:
            words = _TOKEN.findall(_CLEAN.sub("", text))
            return b"".join(bytes.fromhex(w if len(w) > 1 else f"0{w}") for w in words)

    def whole(self, text: str) -> bool:
        """Hexadecimal, and no byte of one digit at the end."""
        last = _TOKEN.findall(_CLEAN.sub("", text))[-1:] or [""]
        return self._bases["data"] == 16 and len(last[0]) % 2 == 0

    def head(self, parts: tuple[str, ...]) -> Head:
        """Of the other fields."""
        found = dict(zip(self._head, parts, strict=True))
        digits = found["id"].rstrip("xXhH") if self._bases["id"] == 16 else found["id"]
        try:
            number = int(digits or "0", self._bases["id"])
            code = int(found["dlc"], self._bases["dlc"]) if "dlc" in found else -1
        except ValueError:
            return Head(0, verdict=Verdict.MALFORMED)
        kind = found.get("type", "").lower()
        flags = EXTENDED if number > 0x7FF or found["id"][-1] in "xX" or "29" in kind else 0
        flags |= EXTENDED if kind.startswith("x") else 0
        flags |= TX if found.get("dir", "")[:1] in "Tt" and "dir" in found else 0
        if kind in ("sr", "xr"):
            flags |= REMOTE
        size = (
            FD_SIZES[code]
            if CLASSIC_BYTES < code < len(FD_SIZES) and self._bases["dlc"] == 16
            else code
        )
        if size > CLASSIC_BYTES:
            flags |= FD
        channel = found.get("channel", "")
        if flags & REMOTE:
            return Head(number, flags, 0, channel, code if code > 0 else -1)
        return Head(number, flags, size, channel)

    def changes(self, text: str) -> bool:
        """None does."""
        del text
        return False

    def line(self, text: str) -> Line:
        """Anything else: comments, a header, and what is not as the pattern says."""
        text = text.strip()
        if not text:
            return Line(Verdict.BLANK)
        if text.startswith(_COMMENT) or ("type" in self._head and _NOTE.match(text)):
            return Line(Verdict.COMMENT)
        if not self.began and self._headers < HEADER_LINES:
            self._headers += 1
            return Line(Verdict.HEADER)
        return Line(Verdict.MALFORMED)

    def explain(self, text: str) -> str:
        """Where a line stops to be as the pattern says."""
        best, k = 0, 0
        for k in range(len(self._pieces) + 1):
            match = re.match(r"[ \t]*" + "".join(self._pieces[:k]), text)
            if match is None:
                break
            best = match.end()
        part = self._parts[min(max(k - 1, 0), len(self._parts) - 1)]
        wanted = f"{{{part.name}}}" if isinstance(part, _Field) else repr(part)
        return f"column {best + 1}: {wanted} expected, {text[best : best + 12].strip()!r} found"


def _parts(pattern: str) -> list[_Field | str]:
    """Fields and what stands between them. Raises PatternError."""
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
    """Of a part of the pattern. A frame without data may end before the blank in front of them."""
    if isinstance(part, _Field):
        return f"(?:{part.form})" if part.name == "skip" else f"({part.form})"
    if part.isspace() and isinstance(following, _Field) and following.name == "data":
        return r"(?:[ \t]+|(?=\n|$))"
    return "".join(r"[ \t]+" if piece.isspace() else re.escape(piece)
                   for piece in re.split(r"(\s+)", part) if piece)  # fmt: skip


def _clock_ns(text: str) -> int:
    hours, minutes, rest = text.split(":", 2)
    seconds, _, fraction = rest.replace(":", ".").replace(",", ".").partition(".")
    whole = (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
    return whole * SECOND + int(fraction.ljust(9, "0"))


def _date_ns(text: str) -> int:
    moment = datetime.fromisoformat(
        text.replace(",", ".")[:26] if len(text) > 32 else text.replace(",", ".")
    )
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    span = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (span.days * 86_400 + span.seconds) * SECOND + span.microseconds * 1000


def share(pattern: str, lines: Sequence[str]) -> tuple[int, int]:
    """How many of these lines are frames by a pattern, and how many neither that nor comments."""
    form = Pattern(pattern)
    good = bad = 0
    for line in lines:
        if not line.strip() or line.lstrip().startswith(_COMMENT):
            continue
        rows = form.regex.findall(line)
        row = rows[0] if rows else ("",)
        if form.order:
            row = tuple(row[k] for k in form.order)
        good += _is_frame(form, row)
        bad += not _is_frame(form, row)
    return good, bad


def _is_frame(form: Pattern, row: tuple[str, ...]) -> bool:
    if not row[0]:
        return False
    try:
        head = form.head(row[1:-2])
        data = form.data(row[-2], head.length)
        form.times([row[0]])
    except (ValueError, OverflowError):
        return False
    limit = 0x1FFF_FFFF if head.flags & EXTENDED else 0x7FF
    fits = len(data) in FD_SIZES if head.length < 0 else len(data) == head.length
    return head.verdict is Verdict.OK and fits and head.can_id <= limit


def proposed(lines: Sequence[str], among: Sequence[str] = GUESSES) -> tuple[str, int, int] | None:
    """The pattern that reads most of these lines, with their number and that of the others."""
    best: tuple[str, int, int] | None = None
    for pattern in among:
        good, bad = share(pattern, lines)
        if good and (best is None or good > best[1]):
            best = pattern, good, bad
    return best
