"""The text of an EDS or DCF (CiA 306) as sections with keys, and its errors.

A repeated section or key, or a line that is neither, is left out and listed; the rest is read. May
know: text.
"""

from __future__ import annotations

import re
import zlib
from typing import Final, NamedTuple

from dbc.text import MOST_BYTES, decoded

_SECTION: Final = re.compile(r"\[([^]]*)\]")
_COMMENT: Final = re.compile(r"(?:^|\s);.*$")
_GZIP: Final = b"\x1f\x8b"
_OF_GZIP: Final = 31
_NODE: Final = "$NODEID"
_HEXADECIMAL: Final = re.compile(r"0X([0-9A-F]+)|([0-9][0-9A-F]*)H")
_LONGEST: Final = 40


class Value(NamedTuple):
    """Value of a key, and where the key is: `[1800sub1] DefaultValue`."""

    text: str
    where: str


class EdsText:
    """Sections and keys, case-insensitive; `faults` lists what was left out."""

    def __init__(self, text: str) -> None:
        self.faults: list[str] = []
        self.sections: dict[str, dict[str, Value]] = {}
        self.objects: list[int] = []
        """Indexes of the objects that have a section."""
        keys: dict[str, Value] = {}
        name = ""
        for number, line in enumerate(text.splitlines(), 1):
            line = _COMMENT.sub("", line).strip()  # noqa: PLW2901
            if not line or line.startswith("#"):
                continue
            if found := _SECTION.fullmatch(line):
                name = found[1].strip()
                keys = self._section(name, number)
            elif "=" in line:
                self._key(keys, name, line, number)
            else:
                self.faults.append(f"line {number}: {line[:_LONGEST]!r} is neither key nor section")

    def _section(self, name: str, number: int) -> dict[str, Value]:
        if name.lower() in self.sections:
            self.faults.append(f"line {number}: section [{name}] is there twice; the first counts")
            return {}
        if re.fullmatch(r"[0-9A-Fa-f]{4}", name):
            self.objects.append(int(name, 16))
        return self.sections.setdefault(name.lower(), {})

    def _key(self, keys: dict[str, Value], section: str, line: str, number: int) -> None:
        key, _, text = (part.strip() for part in line.partition("="))
        where = f"[{section}] {key}"
        if key.lower() in keys:
            self.faults.append(f"line {number}: {where} is there twice; the first counts")
        else:
            keys[key.lower()] = Value(text, where)

    def get(self, section: str, key: str) -> Value | None:
        """Value of a key; None if there is no such section or key."""
        return self.sections.get(section.lower(), {}).get(key.lower())

    def configured(self, index: int, subindex: int | None = None) -> Value | None:
        """Value that a DCF configures for an object, else the default; None if there is neither."""
        section = f"{index:04x}"
        compact = None
        if subindex is not None:
            compact = self.get(f"{section}value", str(subindex))
            section += f"sub{subindex:x}"
        configured = self.get(section, "ParameterValue")
        if configured is not None and configured.text:
            return configured
        return self.get(section, "DefaultValue") or compact or configured

    def name_of(self, index: int, subindex: int) -> str:
        """Name of an object, and of its sub-object if there is one; empty if not in the file."""
        found = [self.get(f"{index:04x}{part}", "ParameterName")
                 for part in ("", f"sub{subindex:x}")]  # fmt: skip
        return ": ".join(value.text for value in found if value and value.text)


def text_of(data: bytes) -> tuple[str, list[str]]:
    """Text of a file, plain or gzip, and its faults.

    Raises ValueError for gzip that cannot be unpacked or is too large.
    """
    if not data.startswith(_GZIP):
        return decoded(data), []
    reader = zlib.decompressobj(_OF_GZIP)
    try:
        unpacked = reader.decompress(data, MOST_BYTES + 1)
    except zlib.error as error:
        raise ValueError(f"cannot be unpacked: {error}") from None
    if len(unpacked) > MOST_BYTES:
        raise ValueError(f"is larger than {MOST_BYTES >> 20} MiB when unpacked")
    return decoded(unpacked), [] if reader.eof else ["the compressed file ends in the middle"]


def number_of(text: str, node: int) -> int | None:
    """Value of `384`, `0x180`, `180h`, `0600`, `$NODEID+0x180`, also in parentheses; else None."""
    words = text.upper().replace(" ", "").replace("(", "").replace(")", "").split("+")
    numbers = [node if word == _NODE else _word_value(word) for word in words]
    known = [number for number in numbers if number is not None]
    return sum(known) if len(known) == len(numbers) else None


def _word_value(word: str) -> int | None:
    if not word.isascii() or len(word) > _LONGEST:
        return None
    sign = -1 if word.startswith("-") else 1
    word = word.removeprefix("-")
    if found := _HEXADECIMAL.fullmatch(word):
        return sign * int(found[1] or found[2], 16)
    if not word.isdecimal():
        return None
    # A number with a leading 0 is octal (CiA 306).
    octal = word.startswith("0") and re.fullmatch(r"[0-7]+", word)
    return sign * int(word, 8 if octal else 10)
