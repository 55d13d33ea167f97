"""CSV of frames, read by its header: of python-can, SavvyCAN, CANedge, Vehicle Spy, IXXAT ..

Columns are found by their names, in any order; unknown ones are ignored. Time is in seconds if it
has a decimal point, in the unit in its column's name, or in microseconds (SavvyCAN's `Time Stamp`);
a whole number of 12 or more digits is in ms, us or ns since 1970, and the unit of shorter ones is
guessed, with a note. CSS Electronics' CL1000 and CL2000 (`Timestamp;Type;ID;Data`) have stamps and
types of their own.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, SECOND, TX
from dbc.logs.csv_columns import UNIT, Columns, columns_of, is_header, row_pattern
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES, LATEST_NS, Format, Head, Line, nanoseconds
from dbc.logs.guesses import too_close, unit_of
from dbc.logs.times import clock_ns, date_ns, logger_ns

_HEX: Final = re.compile(r"(?:[0-9A-Fa-f]{2}\s*)*")
_UNITS_NS: Final = {"ns": 1, "us": 1000, "µs": 1000, "ms": MS}
_WORDS: Final = {"true": True, "false": False, "1": True, "0": False, "": False, "yes": True,
                 "no": False, "1.0": True, "0.0": False, "y": True, "n": False, "t": True,
                 "f": False}  # fmt: skip
_FLAGS: Final = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "brs": BRS,
                 "esi": ESI}  # fmt: skip
_SENT: Final = {"tx": TX, "t": TX, "1": TX, "true": TX, "send": TX, "transmit": TX}
_FORMATS: Final = {"std": 0, "standard": 0, "ext": EXTENDED, "extended": EXTENDED}
_NOTHING: Final = re.compile(r"^()()()(.*)$", re.MULTILINE)
_LOGGER: Final = {"timestamp", "lost", "type", "id", "length", "data"}
"""Columns of a CL1000 or CL2000. `Type`: 0 and 8: 11 bits; 1 and 9: 29 bits; 8 and 9: sent."""
_LOGGER_TYPES: Final = {"0": 0, "1": EXTENDED, "8": TX, "9": EXTENDED | TX}
_LOGGER_START: Final = re.compile(r"# *Time: *(\d{8}T\d{6})\s*")
_SECONDS: Final = re.compile(r"-?\d+\.\d*|\d{10}")
_CLOCK: Final = re.compile(r"\d{1,2}:\d\d:\d\d[.,]\d{1,9}")
_EPOCH_DIGITS: Final = 11
_STAMPS: Final = 1000
"""Number of times by which their unit is guessed."""
_KVASER: Final = ["time", "channel", "id", "flags", "dlc"]
"""First columns of a CSV that Kvaser's converter writes from a Memorator's log."""
_KVASER_BITS: Final = ((1, REMOTE), (4, EXTENDED), (0x20, ERROR), (0x40, TX), (0x10000, FD),
                       (0x20000, BRS), (0x40000, ESI))  # fmt: skip
_ROS: Final = {"isrtr", "isextended", "iserror", "dlc"}
"""Columns of ROS' can_msgs/Frame, all of whose numbers are decimal."""
_BASE: Final = re.compile(r"Format of (id|data) field\W+(HEX|DEC)\b")
_SPREADSHEET: Final = re.compile(r"\b\d[.,]\d+E\+\d+")
_BAD_TIMES: Final = 100
"""Most unreadable times that are kept for error messages."""
NO_DATE: Final = "stamps name a day but no month: it is taken for January 1970"


class Csv(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    def __init__(self, lines: Sequence[str] = ()) -> None:
        """Start without a header. lines: the first ones; others may stand before the header."""
        self.regex = _NOTHING
        self._first_lines = "\n".join(lines)
        self._preamble = any(map(is_header, lines))
        self._head: list[str] = []
        self._separator = ","
        self._unit_ns = 0
        self._savvycan = False
        self._base64 = self._decimal = self._decimal_bytes = False
        self._split = False
        self._logger = self._kvaser = False
        self._bases: dict[str, str] = {}
        self._start: datetime | None = None
        self._bad_times: set[str] = set()
        self.notes: list[str] = []

    def changes(self, text: str) -> bool:
        """True for a header, at the start, or again in files that were concatenated."""
        return columns_of(text) is not None

    def line(self, text: str) -> Line:
        """Parse the header, a comment, or a line that does not have the header's columns."""
        if (columns := columns_of(text)) is not None:
            self._use(columns)
            return Line(Verdict.HEADER)
        if text.lstrip(' "').startswith(("#", ";", "//", "sep=")):
            if started := _LOGGER_START.match(text):
                self._start = _moment(started[1])
            return Line(Verdict.COMMENT)
        if base := _BASE.match(text):
            self._bases[base[1]] = base[2]
        before = self._preamble and self.regex is _NOTHING
        return Line(Verdict.HEADER if before else Verdict.MALFORMED)

    def _use(self, columns: Columns) -> None:
        """Read the lines that follow by this header."""
        separator, titles, plain, kinds = columns
        self._base64 = "arbitrationid" in plain and "data" in plain
        self._decimal = titles == ["time", "addr", "bus", "data"]
        self._split = "data" not in kinds
        self._bytes = kinds.count("byte")
        self._logger = "type" in titles and set(titles) <= _LOGGER
        title = titles[kinds.index("time")]
        unit = UNIT.search(title)
        self._unit_ns = _UNITS_NS.get(unit[1], SECOND) if unit else 0
        self._savvycan = title == "time stamp"
        pattern, groups = row_pattern(separator, kinds, self._split)
        tail = "" if groups[-1] == "data" and self._split else rf"(?:{separator}[^\n]*)?"
        self.regex = re.compile(rf"^(?:{separator.join(pattern)}{tail}|(.*))$", re.MULTILINE)
        self._head = [kind for kind in groups if kind not in ("time", "data")]
        places = [groups.index("time"), *(groups.index(kind) for kind in self._head),
                  groups.index("data"), len(groups)]  # fmt: skip
        self.order = () if places == sorted(places) else tuple(places)
        self._separator = separator
        self._kvaser = titles[: len(_KVASER)] == _KVASER
        if self._kvaser:
            self._decimal = self._bases.get("id") == "DEC"
            self._decimal_bytes = self._bases.get("data") == "DEC"
        elif set(plain) >= _ROS:
            self._decimal = self._decimal_bytes = True
        elif self._split:
            self._see_decimals()

    def _see_decimals(self) -> None:
        """Take bytes for decimal if one of the first has three digits, and none looks hexadecimal.

        Then identifiers of decimal digits alone are decimal as well.
        """
        rows = [row for row in self.regex.findall(self._first_lines) if not row[-1]]
        data = self.order[-2] if self.order else -2
        words = [cell.strip(' "') for row in rows for cell in self._cells(row[data], -1)]
        whole = [word.isdecimal() and (word[0] != "0" or word == "0") for word in words]
        self._decimal_bytes = all(whole) and any(len(word) == len("255") for word in words)
        if self._decimal_bytes:
            at = (self.order or range(len(rows[0])))[1 + self._head.index("id")]
            self._decimal = all(row[at].strip(' "').isdecimal() for row in rows)
            self.notes.append(f"bytes {'and identifiers ' * self._decimal}are decimal numbers")
        elif words and all(whole):
            self.notes.append("numbers are read as hexadecimal: no byte has a letter or 3 digits")

    def _cells(self, text: str, length: int) -> list[str]:
        """Cells of the columns of bytes: as many as `length`, -1 for all that are not empty."""
        cells = text.split(self._separator)[: self._bytes]
        return cells[:length] if length >= 0 else [cell for cell in cells if cell.strip()]

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """Nanoseconds, by the unit in the header or the number of digits of the first time."""
        texts = [text.strip() for text in texts]
        if self._separator != ",":
            texts = [text.replace(",", ".") for text in texts]
        if self._logger:
            return np.array([self._logger_ns(text) for text in texts], dtype=np.int64)
        if texts and not self._unit_ns:
            self._unit_ns = self._guessed_unit(texts)
        try:
            return nanoseconds(texts, self._unit_ns)
        except ValueError:
            return np.array([self._time_ns(text, self._unit_ns) for text in texts], dtype=np.int64)

    def _guessed_unit(self, texts: Sequence[str]) -> int:
        """Unit, ns, of the first times behind a header that states none."""
        whole = [text.removesuffix(".0") for text in texts[:_STAMPS]]
        if self._savvycan:  # whole microseconds, to which pandas adds ".0", or seconds
            if not all(text.lstrip("-").isdecimal() for text in whole):
                return SECOND
            if too_close(whole):
                self.notes.append("times are too close to one another for us: taken for ms")
                return MS
            return 1000
        digits = len(texts[0].lstrip("-")) if "." not in texts[0] else 0
        if digits > _EPOCH_DIGITS:
            return 1 if digits > 17 else 1000 if digits > 14 else MS
        unit, why = unit_of(texts[:_STAMPS])
        if why:
            self.notes.append(f"{why}; a unit in the title of their column counts: `Time (s)`")
        return _UNITS_NS.get(unit, SECOND)

    def _time_ns(self, text: str, unit_ns: int) -> int:
        """Nanoseconds of a number, which may have an exponent, or a date. Raises ValueError."""
        try:
            exact = Decimal(text) * unit_ns
        except InvalidOperation:
            return clock_ns(text) if _CLOCK.fullmatch(text) else self._date_ns(text)
        if not abs(exact) <= LATEST_NS:
            raise ValueError(text)
        return int(exact)

    def _date_ns(self, text: str) -> int:
        """Nanoseconds of a date or CL1000/CL2000 stamp. Raises ValueError, and keeps the text."""
        try:
            if not self._logger or "-" in text:
                return date_ns(text)
            return logger_ns(text, self._start)
        except ValueError:
            if len(self._bad_times) < _BAD_TIMES:
                self._bad_times.add(text)
            raise

    def _logger_ns(self, text: str) -> int:
        """Nanoseconds of a CL1000/CL2000 stamp. Raises ValueError for an ambiguous number."""
        if _SECONDS.fullmatch(text):
            return nanoseconds([text]).item()
        stamp = self._date_ns(text)
        if self._start is None and text.find("T") == len("15") and NO_DATE not in self.notes:
            self.notes.append(NO_DATE)
        return stamp

    def explain(self, text: str) -> str:
        """Reason: no header, or a time that cannot be read; empty if it is neither."""
        if self.regex is _NOTHING:
            return "no header names columns for time, identifier and data (docs/files.md)"
        if changed := _SPREADSHEET.search(text):
            return f"{changed[0]} was a hexadecimal number before a spreadsheet changed it"
        bad = next((time for time in self._bad_times if time and time in text), "")
        if not bad:
            return ""
        known = "15T100000250 or seconds" if self._logger else "a number or an ISO date"
        return f"unknown time {bad!r}, not {known}"

    def data(self, text: str, length: int) -> bytes:
        """Bytes from Base64, or from hexadecimal with any separator between the bytes."""
        if self._base64:
            plain = text.strip(' "')
            # Base64 of as many bytes has either another number of characters or a `=`.
            if _HEX.fullmatch(plain) and (length < 0 or length == len(bytes.fromhex(plain))):
                return bytes.fromhex(plain)
            return binascii.a2b_base64(plain, strict_mode=True)
        if self._split:
            base = 10 if self._decimal_bytes else 16
            return bytes(int(cell.strip(' "'), base) for cell in self._cells(text, length))
        return bytes.fromhex(text) if text.isalnum() and text[1:2] != "x" else _bytes_of(text)

    def whole(self, text: str) -> bool:
        """False if the last byte has one digit and may be cut; one column of data is whole."""
        if self._split:
            last = text.rstrip().split(self._separator)[-1].strip()
            return not last or len(last) == 2
        return True

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from the columns other than time and data."""
        cells = {k: v.strip().strip('"') for k, v in zip(self._head, parts, strict=True)}
        try:
            return self._frame(cells)
        except (ValueError, KeyError, IndexError):
            return Head(0, verdict=Verdict.MALFORMED)

    def _words(self, cells: dict[str, str]) -> int:
        """Flags from the columns `Format`, `Type` and `Flags`."""
        if self._kvaser:
            return _bits(cells["flags"])
        flags = _FORMATS.get(cells.get("format", "").lower(), 0)
        kind = cells.get("type", "").lower() + cells.get("flags", "").lower()
        if "rtr" in kind or "remote" in kind:
            flags |= REMOTE
        return flags | (ERROR if "error" in kind else 0)

    def _frame(self, cells: dict[str, str]) -> Head:
        base = 10 if self._decimal and cells["id"][1:2] != "x" else 16
        flags = self._words(cells)
        digits = cells["id"].removesuffix("x").removesuffix("h")
        number = int(digits, base) if digits or not flags & ERROR else 0
        for name, flag in _FLAGS.items():
            flags |= flag if _WORDS[cells.get(name, "").lower()] else 0
        if self._logger:
            flags |= _LOGGER_TYPES[cells["type"]] | (EXTENDED if number > 0x7FF else 0)
        elif "extended" not in cells:
            flags |= EXTENDED if number > 0x7FF or cells["id"].endswith("x") else 0
        code = _whole(cells["dlc"]) if cells.get("dlc") else -1
        size = _whole(cells["length"]) if cells.get("length") else -1
        if self._kvaser and not flags & FD:
            size = min(code, CLASSIC_BYTES)
        if size < 0 <= code:
            # python-can's dlc is the number of bytes; with a column for CAN FD it is a code.
            size = FD_SIZES[code] if flags & FD else code
        if "fd" not in cells and size > CLASSIC_BYTES and size in FD_SIZES:
            flags |= FD
        if flags & ERROR:
            flags = ERROR
        flags |= _SENT.get(cells.get("direction", "").lower(), 0)
        channel = "_".join(cells.get("channel", "").split())
        if flags & REMOTE:
            return Head(number, flags, 0, channel, max(code, size) or -1)
        raw = code if not flags & FD and CLASSIC_BYTES < code < 16 and size == CLASSIC_BYTES else -1
        return Head(number, flags, size, channel, raw)


def _bits(text: str) -> int:
    """Flags from Kvaser's."""
    number = int(text)
    return sum(flag for bit, flag in _KVASER_BITS if number & bit)


def _bytes_of(text: str) -> bytes:
    """Bytes with any separator between them; a list in brackets, as in Python, is decimal."""
    text = text.strip(' "')
    if text.startswith("["):
        return bytes(int(word, 0) for word in text.strip("[]").split(",") if word.strip())
    words = [word.removeprefix("0x") for word in re.split(r"[^0-9A-Fa-fx]+", text)]
    return bytes.fromhex("".join(f"0{word}" if len(word) == 1 else word for word in words))


def _whole(text: str) -> int:
    """A whole number; pandas writes `8.0` if other rows have no value."""
    return int(text.removesuffix(".0"), 16 if text[:2].lower() == "0x" else 10)


def _moment(text: str) -> datetime | None:
    try:
        return datetime.strptime(text, "%Y%m%dT%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return None
