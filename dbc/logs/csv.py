"""CSV of frames by the names in its header: python-can's, SavvyCAN's (GVRET), CANedge's, pandas'.

Columns are found by their names, in any order; those that nobody knows are passed over. Time is in
seconds where it has a decimal point, in what its column's name says, or in microseconds (SavvyCAN's
`Time Stamp`); a whole number of 12 digits and more is ms, us or ns since 1970.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, SECOND, TX
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES, Head, Line, nanoseconds

_NAMES: Final = {
    "time": "timestamp time timestampepoch t abstime offset",
    "id": "arbitrationid id canid identifier messageid msgid arbid",
    "extended": "extended ide ext isextended isextendedid",
    "remote": "remote rtr isremote isremoteframe",
    "error": "error iserror iserrorframe",
    "fd": "fd edl isfd",
    "brs": "brs bitrateswitch",
    "esi": "esi errorstateindicator",
    "dlc": "dlc",
    "length": "len length datalength size",
    "direction": "dir direction",
    "channel": "bus channel buschannel interface",
    "data": "data databytes payload bytes",
}
_KIND: Final = {name: kind for kind, names in _NAMES.items() for name in names.split()}
_BYTE: Final = re.compile(r"(?:d|b|data|byte)(\d{1,2})")
_UNIT: Final = re.compile(r"[\[(_ ](ns|us|µs|ms|s|sec|seconds)[\])]?$")
_UNITS_NS: Final = {"ns": 1, "us": 1000, "µs": 1000, "ms": MS}
_WORDS: Final = {"true": True, "false": False, "1": True, "0": False, "": False, "yes": True,
                 "no": False, "1.0": True, "0.0": False, "y": True, "n": False}  # fmt: skip
_FLAGS: Final = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "brs": BRS,
                 "esi": ESI}  # fmt: skip
_SENT: Final = {"tx": TX, "t": TX, "1": TX, "true": TX}
_NOTHING: Final = re.compile(r"^()()()(.*)$", re.MULTILINE)


class Csv:
    """The lines of one log, see `dbc.logs.format.Format`."""

    order: tuple[int, ...] = ()
    began = False
    splits = False
    shape = None

    def __init__(self) -> None:
        """Before its header."""
        self.regex = _NOTHING
        self._head: list[str] = []
        self._unit_ns = 0
        self._base64 = False
        self._split = False

    def changes(self, text: str) -> bool:
        """Names of columns, at the start, or again where files were put together."""
        return text.lstrip(' "')[:1].isalpha()

    def line(self, text: str) -> Line:
        """The header; or a line that has not its columns."""
        if not text.strip():
            return Line(Verdict.BLANK)
        if text.startswith(("#", ";", "//", "sep=")):
            return Line(Verdict.COMMENT)
        return Line(Verdict.HEADER if self._read_header(text) else Verdict.MALFORMED)

    def _read_header(self, text: str) -> bool:
        """Whether it is one."""
        separator = max(",;\t", key=text.count)
        titles = [title.strip().strip('"').lower() for title in text.split(separator)]
        plain = [re.sub(r"[^a-z0-9]", "", _UNIT.sub("", title)) for title in titles]
        kinds = [_KIND.get(name, "byte" if _BYTE.fullmatch(name) else "") for name in plain]
        if not {"time", "id"} <= set(kinds) or not {"data", "byte"} & set(kinds):
            return False
        self._base64 = "arbitrationid" in plain and "data" in plain
        self._split = "data" not in kinds
        title = titles[kinds.index("time")]
        unit = _UNIT.search(title)
        self._unit_ns = _UNITS_NS.get(unit[1], SECOND) if unit else 1000 * (title == "time stamp")
        cell, groups, seen = rf"[^{separator}\n]*", [], set()
        pattern = []
        for kind in kinds:
            if kind == "byte" and self._split:
                if "data" not in seen:
                    pattern.append(r"((?:[^\n])*)")
                    groups.append("data")
                seen.add("data")
                break
            if not kind or kind in seen or kind == "byte":
                pattern.append(cell)
                continue
            seen.add(kind)
            groups.append(kind)
            pattern.append(f"({cell})" if kind != "time" else rf"([^{separator}\n]+)")
        tail = "" if self._split else rf"(?:{separator}[^\n]*)?"
        self.regex = re.compile(rf"^(?:{separator.join(pattern)}{tail}|(.*))$", re.MULTILINE)
        self._head = [kind for kind in groups if kind not in ("time", "data")]
        places = [groups.index("time"), *(groups.index(kind) for kind in self._head),
                  groups.index("data"), len(groups)]  # fmt: skip
        self.order = () if places == sorted(places) else tuple(places)
        self._separator = separator
        return True

    def times(self, texts: Sequence[str]) -> NDArray[np.int64]:
        """In the unit that the header or the first number says."""
        if texts and not self._unit_ns:
            digits = len(texts[0].strip().lstrip("-")) if "." not in texts[0] else 0
            self._unit_ns = (
                1 if digits > 17 else 1000 if digits > 14 else MS if digits > 11 else SECOND
            )
        try:
            if any("." in text for text in texts[:1]) and self._unit_ns == 1000:
                return nanoseconds(texts, SECOND)
            return nanoseconds(texts, self._unit_ns)
        except ValueError:
            return np.array([_date_ns(text) for text in texts], dtype=np.int64)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """As they are."""
        del timed
        return times

    def data(self, text: str, length: int) -> bytes:
        """Base64, or hexadecimal with anything between the bytes."""
        if self._base64:
            return binascii.a2b_base64(text.strip(' "'), strict_mode=True)
        if self._split:
            cells = text.split(self._separator)
            found = cells[:length] if length >= 0 else [cell for cell in cells if cell.strip()]
            return bytes(int(cell.strip().strip('"'), 16) for cell in found)
        return bytes.fromhex(re.sub(r"0x|[^0-9A-Fa-fx]", "", text) if not text.isalnum() else text)

    def whole(self, text: str) -> bool:
        """Base64 cannot be of this length otherwise; a byte of one digit may go on."""
        if self._split:
            last = text.rstrip().split(self._separator)[-1].strip()
            return not last or len(last) == 2
        return True

    def head(self, parts: tuple[str, ...]) -> Head:
        """Of the other columns."""
        cells = {k: v.strip().strip('"') for k, v in zip(self._head, parts, strict=True)}
        try:
            return self._frame(cells)
        except (ValueError, KeyError, IndexError):
            return Head(0, verdict=Verdict.MALFORMED)

    def _frame(self, cells: dict[str, str]) -> Head:
        number = int(cells["id"].removesuffix("x").removesuffix("h"), 16)
        flags = 0
        for name, flag in _FLAGS.items():
            flags |= flag if _WORDS[cells.get(name, "").lower()] else 0
        if "extended" not in cells and (number > 0x7FF or len(cells["id"].removeprefix("0x")) > 4):
            flags |= EXTENDED
        code = int(cells["dlc"], 0) if cells.get("dlc") else -1
        size = int(cells["length"]) if cells.get("length") else -1
        if size < 0 <= code:
            # python-can's dlc is the number of bytes; a code where CAN FD has its own column.
            size = FD_SIZES[code] if flags & FD else code
        if "fd" not in cells and size > CLASSIC_BYTES and size in FD_SIZES:
            flags |= FD
        if flags & ERROR:
            flags = ERROR
        flags |= _SENT.get(cells.get("direction", "").lower(), 0)
        channel = cells.get("channel", "")
        if flags & REMOTE:
            return Head(number, flags, 0, channel, max(code, size) or -1)
        raw = code if not flags & FD and CLASSIC_BYTES < code < 16 and size == CLASSIC_BYTES else -1
        return Head(number, flags, size, channel, raw)


def is_header(text: str) -> bool:
    """Whether a line names the columns of a log."""
    return Csv().line(text).verdict is Verdict.HEADER


def _date_ns(text: str) -> int:
    """ISO 8601; UTC where it names no zone."""
    moment = datetime.fromisoformat(text.strip().strip('"'))
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    span = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (span.days * 86_400 + span.seconds) * SECOND + span.microseconds * 1000
