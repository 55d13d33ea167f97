"""Text from outside: quoted in our own messages, decoded, or parsed as TOML."""

from __future__ import annotations

import codecs
import errno
import math
import re
import tomllib
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Final

MOST: Final = 1000
MOST_BYTES: Final = 64 << 20
"""Largest configuration, scenario or DBC: a device such as /dev/zero has no end."""

_CHINESE: Final = re.compile(rb"(?:[\x00-\x7f]++|(?:[\xa1-\xf7][\xa1-\xfe])++)*+")
"""Every byte above 127 is one of a pair."""
_SURELY_CHINESE: Final = re.compile(rb"[\x80-\xff]{4}|\xa1\xe6")
"""Two characters side by side, or the sign for degrees Celsius: not so in a western language."""
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")


class InputError(Exception):
    """A file or a setting that cannot be used. The text states what is wrong, and the remedy."""


class TomlError(ValueError):
    """Text that is not TOML, or TOML that cannot be represented; the message is one line."""


def printable(text: str, most: int = MOST) -> str:
    """The text with control characters and line ends escaped, its middle left out beyond `most`.

    The message that rejects a file quotes it. An escape sequence in the file must not reach the
    terminal or the journal, and a line end must not split the message in two.
    """
    if len(text) > most:
        text = f"{text[: most // 2]} .. {text[-(most // 2) :]}"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def near(given: object, names: Iterable[str]) -> str:
    """Return `; did you mean 'node'?`, or an empty text if no name is similar to the given one."""
    import difflib

    of = {name.lower(): name for name in names if name != given}
    found = difflib.get_close_matches(str(given).lower(), of, 1)
    return f"; did you mean {of[found[0]]!r}?" if found else ""


def number_or_nan(text: str) -> float:
    """The number in a text, or NaN, which no range of numbers includes."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def without_colours(text: str) -> str:
    """The text without the escape sequences for terminal colours (`candump -c`)."""
    return _COLOUR.sub("", text) if "\x1b" in text else text


def read_bytes(path: Path) -> bytes:
    """A whole file. Raises OSError, also if it has more than `MOST_BYTES`."""
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"larger than {MOST_BYTES >> 20} MiB", str(path))
    return content


def decoded(data: bytes) -> str:
    """The text of a DBC: valid UTF-8, with or without a byte order mark; else GBK or cp1252.

    UTF-16 with a byte order mark is decoded, too.
    """
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if _CHINESE.fullmatch(data) and _SURELY_CHINESE.search(data):
            return data.decode("gb18030", "replace")
        # The five bytes not defined in cp1252 become replacement characters.
        return "".join(bytes([b]).decode("cp1252", "replace") if b > 127 else chr(b) for b in data)


def without_mark(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield a file without its byte order mark; UTF-16, which Windows shells write, as UTF-8."""
    pieces = iter(chunks)
    first = next(pieces, b"")
    if first[:2] not in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        yield first.removeprefix(codecs.BOM_UTF8)
        yield from pieces
        return
    decoder = codecs.getincrementaldecoder("utf-16")("replace")
    for piece in chain([first], pieces):
        yield decoder.decode(piece).encode("utf-8", "replace")
    yield decoder.decode(b"", final=True).encode("utf-8", "replace")


def toml_text(content: bytes) -> str:
    """The text of a TOML file. Raises TomlError with the cure if it is not UTF-8."""
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        raise TomlError("UTF-16, as some Windows programs save; save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        byte = content[error.start]
        raise TomlError(f"line {line}: byte {byte:#04x} is no UTF-8; save it as UTF-8") from None
    if "\r" in text and "\n" not in text:
        raise TomlError("lines end in CR only; save it with LF or CR LF")
    return text


def read_toml(text: str) -> dict[str, Any]:
    """Parse TOML. Raises TomlError only.

    `tomllib` also raises other exceptions: RecursionError if brackets are nested some hundred deep,
    and a bare ValueError for whole numbers of more than 4,300 digits.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("nested too deeply") from None
    except ValueError as error:
        raise TomlError(str(error)) from None
