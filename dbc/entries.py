"""A DBC as its entries, so that one that is wrong can be left out and the others be read.

cantools reads a file whole or not at all. Here lines that it cannot take are blanked, so that the
others keep their numbers, and each is listed with its line and the reason.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, NamedTuple

_KEYWORD: Final = re.compile(
    r"\s*(VERSION|NS_|BS_|BU_|VAL_TABLE_|BO_TX_BU_|BO_|SG_MUL_VAL_|SG_|SIG_VALTYPE_|SIGTYPE_VALTYPE_|"
    r"SIG_GROUP_|SIG_TYPE_REF_|SGTYPE_|SGTYPE_VAL_|VAL_|CM_|BA_DEF_DEF_REL_|BA_DEF_DEF_|BA_DEF_REL_|"
    r"BA_DEF_SGTYPE_|BA_DEF_|BA_SGTYPE_|BA_REL_|BA_|EV_DATA_|EV_|ENVVAR_DATA_|CAT_DEF_|CAT_|FILTER)"
    r"(?![A-Za-z0-9_])"
)
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MESSAGE: Final = re.compile(r"\s*BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)\s+(\S+)\s*")
_SIGNAL: Final = re.compile(
    rf"\s*SG_\s+(\w+)\s*(?:M|m\d+M?)?\s*:\s*(\d+)\s*\|\s*(\d+)\s*@\s*[01]\s*[+-]\s*"
    rf"\(\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\)\s*"
    rf"\[\s*({_NUMBER})\s*\|\s*({_NUMBER})\s*\]\s*\"[^\"]*\"\s*[\w\s,]*"
)
_REFERENCE: Final = re.compile(r"\s*(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_)\s+(\d+)\s+(\w+)")
_ABOUT: Final = re.compile(
    r"\s*(?:CM_|BA_\s+\"[^\"]*\")\s+(BO_|SG_)\s+(\d+)(?:\s+(\w+))?|\s*BO_TX_BU_\s+(\d+)"
)
_TO: Final = re.compile(r"\d\s*-\s*(\d+)")
_INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"
_ENDED: Final = frozenset({
    "VAL_", "VAL_TABLE_", "CM_", "BA_DEF_", "BA_DEF_DEF_", "BA_", "SIG_VALTYPE_", "SG_MUL_VAL_",
    "SIG_GROUP_", "BO_TX_BU_",
})  # fmt: skip
_MOST_BYTES, _MOST_BITS, _LAST_BIT, _LAST_MUX = 64, 64, 511, 0xFFFF
_DIGITS: Final = 300


class Entry(NamedTuple):
    """One entry: its first line, counted from 0, the line behind it, keyword and text."""

    first: int
    last: int
    keyword: str
    text: str


class LeftOut(NamedTuple):
    """An entry that is not used: its line, counted from 1, what it is, and why."""

    line: int
    what: str
    why: str

    def __str__(self) -> str:
        """As a person reads it."""
        return f"line {self.line}: {self.what}: {self.why}"


class Entries:
    """The entries of a text; `text` without those that were left out, which `left_out` lists."""

    def __init__(self, text: str) -> None:
        """Entries that cannot be are left out at once, and what refers to them."""
        self._lines = text.split("\n")
        self.left_out: list[LeftOut] = []
        self._entries = _split(self._lines)
        if not any(entry.keyword == "BU_" for entry in self._entries):
            self._add_nodes()
        self._check()

    @property
    def text(self) -> str:
        """Of all entries that are left."""
        return "\n".join(self._lines)

    def _add_nodes(self) -> None:
        """An empty list of nodes in the line before the first message: cantools wants one."""
        first = next((e.first for e in self._entries if e.keyword == "BO_"), 0)
        if first:
            self._lines[first - 1] += " BU_:"

    def _drop(self, entry: Entry, why: str, *, silently: bool = False) -> None:
        for k in range(entry.first, entry.last):
            self._lines[k] = ""
        if not silently:
            what = " ".join(entry.text.split(":")[0].split()[:3])
            self.left_out.append(LeftOut(entry.first + 1, what[:80], why))

    def _check(self) -> None:
        """Messages and signals by their form; other entries by what they refer to."""
        known: dict[int, set[str]] = {}
        gone: set[int] = set()
        kept: list[Entry] = []
        message: int | None = None
        for entry in self._entries:
            if entry.keyword == "BO_":
                number, why = _message_fault(entry.text)
                unused = _INDEPENDENT in entry.text
                message = None if why or unused else number
                if message is None:
                    gone |= {number} if number is not None else set()
                    # Where editors keep signals that no message has.
                    self._drop(entry, why, silently=unused)
                    continue
                known.setdefault(message, set())
            elif entry.keyword == "SG_":
                if message is None:
                    self._drop(entry, "", silently=True)
                    continue
                if why := _signal_fault(entry.text):
                    self._drop(entry, why)
                    continue
                match = _SIGNAL.match(entry.text)
                assert match is not None
                known[message].add(match[1])
            elif entry.keyword != "BO_TX_BU_":
                message = None
            kept.append(entry)
        self._entries = [e for e in kept if not self._is_stray(e, known, gone)]

    def _is_stray(self, entry: Entry, known: dict[int, set[str]], gone: set[int]) -> bool:
        """Drop what refers to a message or signal that is not there."""
        if entry.keyword in _ENDED and not _is_ended(entry.text):
            self._drop(entry, "does not end in a semicolon, or its quotes do not match")
            return True
        if match := _REFERENCE.match(entry.text):
            number, name = int(match[1]), match[2]
            if number in known and (name in known[number] or entry.keyword == "SIG_GROUP_"):
                if entry.keyword == "SG_MUL_VAL_" and any(
                    int(value) > _LAST_MUX for value in _TO.findall(entry.text)
                ):
                    self._drop(entry, "multiplexer values above 65535")
                    return True
                return False
            self._drop(entry, "of a signal that the file does not have", silently=number in gone)
            return True
        if match := _ABOUT.match(entry.text):
            number = int(match[2] or match[4])
            if number not in known or (
                match[3] and match[1] == "SG_" and match[3] not in known[number]
            ):
                self._drop(entry, "about what the file does not have", silently=True)
                return True
        if len(entry.text) > _DIGITS and re.search(
            rf"\d{{{_DIGITS}}}", re.sub(r'"[^"]*"', "", entry.text)
        ):
            self._drop(entry, "a number with more than 300 digits")
            return True
        return False

    def drop_line(self, line: int, why: str) -> bool:
        """Leave out the entry that has this line, counted from 1. False if there is none."""
        for place, entry in enumerate(self._entries):
            if entry.first < line <= entry.last:
                self._drop(entry, why)
                del self._entries[place]
                if entry.keyword == "BO_":
                    while place < len(self._entries) and self._entries[place].keyword == "SG_":
                        self._drop(self._entries.pop(place), "", silently=True)
                return True
        return False

    def drop_all(self, wanted: Callable[[Entry], bool], why: str, *, each: bool = False) -> bool:
        """Leave out all of a kind, with one line or `each` with its own. False if there is none."""
        found = [entry for entry in self._entries if wanted(entry)]
        for entry in found:
            self._drop(entry, why, silently=not each and entry is not found[0])
        self._entries = [entry for entry in self._entries if not wanted(entry)]
        return bool(found)


def _split(lines: list[str]) -> list[Entry]:
    """Entries begin with a keyword outside of a text in quotes."""
    starts: list[tuple[int, str]] = []
    quoted = False
    symbols = False
    for k, line in enumerate(lines):
        if not quoted and (match := _KEYWORD.match(line)):
            word = match[1]
            # The list of keywords at the start of most files.
            if word == "NS_":
                symbols = True
                starts.append((k, word))
            elif not (symbols and line.strip() == word):
                symbols = False
                starts.append((k, word))
        if line.count('"') % 2:
            quoted = not quoted
    if not starts:
        return []
    ends = [k for k, _ in starts[1:]] + [len(lines)]
    return [
        Entry(k, end, word, "\n".join(lines[k:end]).rstrip())
        for (k, word), end in zip(starts, ends, strict=True)
    ]


def _is_ended(text: str) -> bool:
    """Whether an entry that ends in a semicolon does."""
    return text.rstrip().endswith(";") and text.count('"') % 2 == 0


def _message_fault(text: str) -> tuple[int | None, str]:
    """Its number and why it cannot be used, or an empty text."""
    match = _MESSAGE.fullmatch(text)
    if match is None:
        return None, "is no message (BO_ number name: bytes sender)"
    number, size = int(match[1]), int(match[3])
    if size > _MOST_BYTES:
        return number, f"{size} bytes; CAN FD has 64"
    if number & 0x1FFF_FFFF > (0x1FFF_FFFF if number >> 31 else 0x7FF):
        return number, f"no frame has the identifier {number}"
    return number, ""


def _signal_fault(text: str) -> str:
    """Why it cannot be used, or an empty text."""
    match = _SIGNAL.fullmatch(text)
    if match is None:
        return (
            "is no signal (SG_ name : start|length@order sign (scale,offset) [min|max] unit nodes)"
        )
    start, size = int(match[2]), int(match[3])
    if not 1 <= size <= _MOST_BITS:
        return f"{size} bits; 1 to 64 are possible"
    if start > _LAST_BIT:
        return f"starts at bit {start} of 512"
    if any(len(text) > _DIGITS or abs(float(text)) == float("inf") for text in match.groups()[3:]):
        return "a number that no double has"
    return ""
