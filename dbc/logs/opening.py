"""Choose the reader of a log by the file's ending, or by its content if that is not known."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from dbc.candump.grammar import parse_line
from dbc.candump.reader import LogError, LogReader, Reader
from dbc.logs.format import Format
from dbc.text import without_colours, without_mark

_LOOKED_AT: Final = 1 << 16
LINES: Final = 100
"""Number of lines by which a format is recognised."""
_ASC: Final = re.compile(rb"date\s+\S|base\s+(hex|dec)\b|begin\s+triggerblock", re.I)
_TRC: Final = re.compile(rb";\$\w+=")
_PACKED: Final = {
    b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bzip2", b"PK\3\4": "zip",
    b"7z\xbc\xaf": "7z", b"\x04\x22\x4d\x18": "lz4",
}  # fmt: skip
"""Starts of files that none of the readers unpacks."""
_CAPTURES: Final = (
    b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d", b"\n\r\r\n",
)  # fmt: skip
"""Starts of pcap files, in us and ns, and of pcapng."""
_WORKBOOKS: Final = (".xlsx", ".xlsm", ".ods")
TEXT: Final = (".asc", ".trc", ".csv")
OTHERS: Final = (".blf", ".mf4", ".db")


def ending(path: Path) -> str:
    """Ending of a file name in lower case, without `.gz`."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def open_reader(path: Path, *, strict: bool, line: str = "") -> LogReader:
    """The reader of an existing file. line: a pattern of its lines (`dbc.logs.pattern`).

    Raises PatternError, or LogError if no reader fits, as for a compressed file or a capture.
    """
    _refuse_others(path)
    kind = ending(path)
    if not line and kind not in OTHERS and not _fits_ending(kind, path):
        found = _by_content(path)
        kind = found if found or kind not in TEXT or _is_candump(path) else kind
    form = _by_pattern(line, path) if line else _format(kind, path)
    if form is not None:
        from dbc.logs.text import TextReader

        return TextReader(path, form, strict=strict)
    if kind in OTHERS:
        return _binary(path, kind, strict)
    return Reader(path, strict=strict)


def _refuse_others(path: Path) -> None:
    """Raises LogError for a file compressed by anything but gzip, a capture, and a workbook."""
    with path.open("rb") as stream:
        start = stream.read(8)
    if start.startswith(_CAPTURES):
        why = "is a capture of Wireshark (pcap): open it in SavvyCAN, and save it as CSV"
        raise LogError(str(path), 0, why)
    if start.startswith(b"PK") and path.suffix.lower() in _WORKBOOKS:
        raise LogError(str(path), 0, "is a workbook of a spreadsheet: save the sheet as CSV")
    for magic, name in _PACKED.items():
        if start.startswith(magic):
            raise LogError(str(path), 0, f"is compressed ({name}): unpack it, or use gzip")


def _fits_ending(kind: str, path: Path) -> bool:
    """Whether the first lines are of the format that the ending names."""
    lines = first_lines(path)
    if kind == ".csv":
        from dbc.logs.csv_columns import is_header

        return any(is_header(line.decode("latin-1")) for line in lines)
    mark = {".asc": _ASC, ".trc": _TRC}.get(kind)
    return mark is not None and any(map(mark.match, lines))


def _is_candump(path: Path) -> bool:
    return any(parse_line(line)[1] is not None for line in first_lines(path))


def _by_pattern(pattern: str, path: Path) -> Callable[[], Format]:
    """A function that makes formats for lines of this pattern. Raises PatternError."""
    from dbc.logs.dialects import format_of

    lines = _first_texts(path)
    format_of(pattern)
    return lambda: format_of(pattern, lines)


def _format(kind: str, path: Path) -> Callable[[], Any] | None:
    if kind == ".asc":
        from dbc.logs.asc import Asc

        return Asc
    texts = _first_texts(path) if kind in TEXT else []
    if kind == ".trc":
        from dbc.logs.trc import Trc

        return lambda: Trc(texts)
    if kind == ".csv":
        from dbc.logs.csv import Csv

        return lambda: Csv(texts)
    if "{" in kind:
        return _by_pattern(kind, path)
    return None


def _binary(path: Path, kind: str, strict: bool) -> LogReader:
    if kind == ".blf":
        from dbc.logs.blf import Blf

        return Blf(path, strict=strict)
    if kind == ".mf4":
        from dbc.logs.mf4 import Mf4

        return Mf4(path, strict=strict)
    from dbc.logs.python_can import PythonCan

    return PythonCan(path, strict=strict)


def first_lines(path: Path) -> list[bytes]:
    """The first `LINES` whole lines of a text, plain or gzip; none if the gzip is damaged."""
    with path.open("rb") as stream:
        data = stream.read(_LOOKED_AT)
    if data[:2] == b"\x1f\x8b":
        try:
            data = zlib.decompressobj(wbits=31).decompress(data, _LOOKED_AT)
        except zlib.error:
            return []
    plain = b"".join(without_mark([data])).decode("latin-1")
    text = without_colours(plain).encode("latin-1")
    end = text.rfind(b"\n") + 1 or len(text)
    return text[:end].splitlines()[:LINES]


def _first_texts(path: Path) -> list[str]:
    return [line.decode("latin-1") for line in first_lines(path)]


def _by_content(path: Path) -> str:
    """The ending that fits the content, a pattern of its lines, or "" for candump's text."""
    with path.open("rb") as stream:
        magic = stream.read(8)
    if magic[:4] == b"LOGG":
        return ".blf"
    if magic[:3] == b"MDF" or magic[:7] == b"UnFinMF":
        return ".mf4"
    if _is_candump(path):
        return ""
    lines = first_lines(path)
    if any(_ASC.match(line) for line in lines[:5]):
        return ".asc"
    if any(line.startswith(b";$FILEVERSION") for line in lines[:5]):
        return ".trc"
    from dbc.logs.csv_columns import is_header
    from dbc.logs.dialects import BUSMASTER, BUSMASTER_MARK
    from dbc.logs.proposals import recognised
    from dbc.logs.trc import BARE

    texts = _first_texts(path)
    if sum(map(bool, map(BARE.match, texts))) * 2 > len(texts):
        return ".trc"
    if any(is_header(text) for text in texts):
        return ".csv"
    if any(line.startswith(BUSMASTER_MARK) for line in lines[:5]):
        return BUSMASTER
    found = recognised(texts)
    return found.pattern if found is not None else ""
