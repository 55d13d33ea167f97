"""Attributes of a DBC: definitions, defaults and values that cannot be used, and why."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from typing import Final, NamedTuple

from dbc.entry_checks import NUMBER
from dbc.entry_text import TEXT, Entry

_DEFINITION: Final = re.compile(
    rf"(\s*BA_DEF_\s+(?:(?:BO_|SG_|BU_|EV_)\s+)?({TEXT})\s+(\w+))\s*(.*?)\s*;", re.DOTALL
)
_DEFAULT: Final = re.compile(rf"\s*BA_DEF_DEF_\s+({TEXT})\s*(\S.*?)\s*;", re.DOTALL)
_VALUE: Final = re.compile(
    rf"(\s*BA_\s+({TEXT})\s*(?:BO_\s+\d+|SG_\s+\d+\s+\w+|BU_\s+\w+|EV_\s+\w+)?)\s*(\S.*?)\s*;",
    re.DOTALL,
)
_NAME: Final = re.compile(rf"\s*\w+\s+({TEXT})")
_RELATION: Final = re.compile(rf"\s*BA_DEF_REL_\s+\w+\s+({TEXT})")
_OF_RELATIONS: Final = ("BA_REL_", "BA_DEF_DEF_REL_")
_CHOICES: Final = re.compile(rf"{TEXT}(?:\s*,\s*{TEXT})*")
_WHOLE: Final = ("INT", "HEX", "ENUM")
_NUMBERS: Final = ("INT", "HEX", "FLOAT")
_AS_NUMBER: Final = ("GenSigStartValue", "GenMsgCycleTime", "SPN")
"""Attributes for which cantools accepts nothing but a number."""
_INDEXED: Final = ("VFrameFormat", "GenMsgSendType")
"""Attributes whose value cantools uses as an index into the values of the definition."""
_FRAME_FORMATS: Final = 16
_LONGEST: Final = 300


class Kind(NamedTuple):
    """Type of an attribute, and the texts of an ENUM."""

    type_name: str
    choices: tuple[str, ...]


class Fault(NamedTuple):
    """A faulty entry: why it or a part of it is unusable, and the usable text, None without one.

    `why` is empty where the entry only has to be rewritten for cantools.
    """

    entry: Entry
    why: str
    mended: str | None


def faults(entries: Sequence[Entry]) -> Iterator[Fault]:
    """Yield the faults of all attributes, those of definitions before those of values."""
    kinds: dict[str, Kind] = {}
    for entry in entries:
        if entry.keyword == "BA_DEF_" and (match := _DEFINITION.fullmatch(entry.text)):
            name = match[2][1:-1]
            fault, limits = _limits(match[3], match[4])
            if fault:
                yield Fault(entry, fault, f"{match[1]} {limits};")
            choices = re.findall(TEXT, match[4]) if match[3] == "ENUM" and not fault else []
            kinds[name] = Kind(match[3], tuple(text[1:-1] for text in choices))
    for entry in entries:
        if entry.keyword == "BA_DEF_DEF_" and (match := _DEFAULT.fullmatch(entry.text)):
            kind = kinds.get(match[1][1:-1])
            # The default of an ENUM is a text, so that only numbers are checked.
            if kind and kind.type_name in _NUMBERS and (why := _misfit(kind, match[2])):
                yield Fault(entry, why, None)
        elif entry.keyword == "BA_" and (match := _VALUE.fullmatch(entry.text)):
            yield from _value(entry, match, kinds)
    yield from _relations(entries)


def _relations(entries: Sequence[Entry]) -> Iterator[Fault]:
    """Yield values and defaults of relation attributes that no BA_DEF_REL_ defines."""
    matches = [_RELATION.match(e.text) for e in entries if e.keyword == "BA_DEF_REL_"]
    defined = {match[1] for match in matches if match}
    for entry in entries:
        match = _NAME.match(entry.text) if entry.keyword in _OF_RELATIONS else None
        if match and match[1] not in defined:
            yield Fault(entry, f"no attribute {match[1][1:-1]!r} is defined (BA_DEF_REL_)", None)


def defined_by(entry: Entry) -> str:
    """Name of the attribute that a BA_DEF_ defines; empty for any other entry."""
    match = _DEFINITION.fullmatch(entry.text) if entry.keyword == "BA_DEF_" else None
    return match[2][1:-1] if match else ""


def named_by(entry: Entry) -> str:
    """Name of the attribute whose value or default an entry gives; empty for any other entry."""
    match = None
    if entry.keyword in ("BA_", "BA_DEF_DEF_"):
        match = _NAME.match(entry.text)
    return match[1][1:-1] if match else ""


def _limits(kind: str, text: str) -> tuple[str, str]:
    """Why limits or choices cannot be read (empty: they can), and the text to write instead."""
    if kind in _NUMBERS:
        numbers = text.split()
        if len(numbers) not in (0, 2) or not all(map(_is_number, numbers)):
            return f"its limits {text[:40]!r} are left out: not two numbers", ""
        if kind != "FLOAT" and not all(map(_is_finite, numbers)):
            return f"its limits {text[:40]!r} are left out: no number can be so large", ""
    elif kind == "ENUM" and text and not _CHOICES.fullmatch(text):
        return f"its values {text[:40]!r} are left out: not texts in quotes, with commas", ""
    return "", text


def _value(entry: Entry, match: re.Match[str], kinds: dict[str, Kind]) -> Iterator[Fault]:
    """Yield the fault of a value whose attribute is not defined or cannot have it."""
    name, value = match[2][1:-1], match[3]
    kind = kinds.get(name)
    if kind is None:
        yield Fault(entry, f"no attribute {name!r} is defined (BA_DEF_)", None)
        return
    text = value[1:-1] if value.startswith('"') else value
    if kind.type_name == "ENUM" and text in kind.choices:
        if value.startswith('"') and not _is_number(text):
            mended = f"{match[1]} {kind.choices.index(text)};"
            yield Fault(entry, "", mended)
        return
    if why := _misfit(kind, value):
        yield Fault(entry, why, None)
    elif name in _INDEXED and kind.type_name in (*_NUMBERS, "ENUM"):
        count = _count(name, kind)
        if not 0 <= Decimal(text) < count:
            why = f"{text} is not an index of its {count} values (the first is 0)"
            yield Fault(entry, why, None)
    elif name in _AS_NUMBER and kind.type_name not in (*_NUMBERS, "ENUM"):
        yield Fault(entry, f"{name} is a number; it is defined as {kind.type_name}", None)


def _count(name: str, kind: Kind) -> float:
    """Number of values of an attribute whose value is an index; infinite if not known."""
    if name == "VFrameFormat" and kind.type_name == "INT":
        return _FRAME_FORMATS
    return len(kind.choices) if kind.choices else float("inf")


def _misfit(kind: Kind, value: str) -> str:
    """Why an attribute of this type cannot have this value; empty if it can."""
    text = value[1:-1] if value.startswith('"') else value
    if kind.type_name not in (*_NUMBERS, "ENUM"):
        return ""
    if not _is_number(text) or (kind.type_name in _WHOLE and not _is_finite(text)):
        return f"{value[:40]} is not a number, as its type {kind.type_name} requires"
    return ""


def _is_number(text: str) -> bool:
    return re.fullmatch(NUMBER, text.strip()) is not None


def _is_finite(text: str) -> bool:
    """Whether a number can be converted to a whole one without filling the memory."""
    try:
        return len(text) < _LONGEST and abs(Decimal(text)) < 1 << 64
    except InvalidOperation:
        return False
