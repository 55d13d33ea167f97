"""A DBC as a list of entries, so that a wrong one can be left out and the others can be read.

cantools reads a file whole or not at all. Entries that it cannot read are left out here, and each
is listed with its line and the reason. If such an entry defines how a signal is decoded
(SIG_VALTYPE_, SG_MUL_VAL_), the signal is unusable too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

from dbc import attributes
from dbc.entry_checks import (
    Checked,
    labels_of,
    message_of,
    multiplexing_of,
    number_of,
    signal_of,
    stand_in,
    value_type_of,
)
from dbc.entry_text import ENDED, TEXT, Entry, split

_REFERENCE: Final = re.compile(r"\s*(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_)\s+(\d+)\s+(\w+)")
_ABOUT: Final = re.compile(
    rf"\s*(?:CM_|BA_\s+{TEXT})\s+(BO_|SG_)\s+(\d+)(?:\s+(\w+))?|\s*BO_TX_BU_\s+(\d+)"
)
_NUMBER: Final = re.compile(
    r"\s*(?:BO_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|BO_TX_BU_|(?:CM_|"
    rf"BA_\s+{TEXT}|BA_REL_\s+{TEXT}\s+BU_(?:BO|SG)_REL_\s+\w+)\s+(?:(?:BO_|SG_)\s+)?)\s*(\d+)\b"
)
"""The number of the message that an entry is or refers to."""
_ELEVEN_BITS: Final = 0x7FF
_MARK: Final = 1 << 31
_LONG: Final = re.compile(
    rf'\s*BA_\s+"SystemSignalLongSymbol"\s+SG_\s+(\d+)\s+(\w+)\s+({TEXT})\s*;'
)
_INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"
_READING: Final = frozenset({"SIG_VALTYPE_", "SG_MUL_VAL_"})
"""Entries without which a signal would be decoded wrongly."""
_ORDER: Final = {"BA_DEF_DEF_": 1, "BA_DEF_": 2, "BA_": 3}
_DIGITS: Final = re.compile(r"\d{300}")


class LeftOut(NamedTuple):
    """An entry that is not used: its line, counted from 1, what it is, and why."""

    line: int
    what: str
    why: str

    def __str__(self) -> str:
        """One line for a person."""
        return f"line {self.line}: {self.what}: {self.why}"


class Entries:
    """The usable entries of a text; `left_out` lists the others.

    unusable: by message number and signal name, why a signal is not decoded although an entry for
    it is kept. listed: those of these signals that are already in `left_out`.
    """

    def __init__(self, text: str) -> None:
        """Split the text, and leave out impossible entries and those that refer to them."""
        self.left_out: list[LeftOut] = []
        self.unusable: dict[tuple[int, str], str] = {}
        self.listed: set[tuple[int, str]] = set()
        self.multiplexed: set[tuple[int, str]] = set()
        """Signals that their own entry marks as multiplexed."""
        self._known: dict[int, dict[str, int]] = {}
        """By message number: the names of its signals, and the size of each in bits."""
        self._gone: set[int] = set()
        # The list of keywords (NS_) and the bit rate (BS_) have no effect.
        text = text.rstrip("\0\x1a \t\r\n")
        found = [e for e in split(text) if e.keyword not in ("NS_", "BS_")]
        self.entries = [self._marked(e) for e in found if not self._is_foreign(e)]
        self._check_messages()
        self.entries = [new for e in self.entries if (new := self._checked(e)) is not None]
        self._check_attributes()
        # Each entry comes behind those that it needs.
        self.entries.sort(key=lambda e: _ORDER.get(e.keyword, 4 * (e.keyword in ENDED)))

    def lines(self) -> dict[str, int]:
        """Line of each `Message` and `Message.Signal`."""
        found: dict[str, int] = {}
        message = ""
        for entry in self.entries:
            if entry.keyword == "BO_":
                message = message_of(entry.text).name
                found.setdefault(message, entry.line)
            elif entry.keyword == "SG_":
                found.setdefault(f"{message}.{signal_of(entry.text).name}", entry.line)
        return found

    def long_names(self) -> dict[tuple[int, str], str]:
        """Long names of signals, which cantools uses instead of those in their entries."""
        found = (_LONG.fullmatch(e.text) for e in self.entries if e.keyword == "BA_")
        return {(number_of(m[1]), m[2]): m[3][1:-1] for m in found if m}

    def drop(self, found: Sequence[tuple[Entry, str]]) -> None:
        """Leave these entries out; each is listed with its reason.

        The signals of a dropped message and the values of a dropped attribute are dropped as well.
        """
        undefined = {name for entry, _ in found if (name := attributes.defined_by(entry))}
        reasons = {id(entry): why for entry, why in found}
        kept: list[Entry] = []
        gone = False
        for entry in self.entries:
            gone = id(entry) in reasons if entry.keyword != "SG_" else gone
            if id(entry) in reasons:
                self._list(entry, reasons[id(entry)])
            elif not (gone and entry.keyword == "SG_") and (
                attributes.named_by(entry) not in undefined
            ):
                kept.append(entry)
        self.entries = kept

    def _list(self, entry: Entry, why: str) -> None:
        """Add an entry to `left_out`; if it defines how a signal is decoded, lose that signal."""
        what = " ".join(entry.text.split(":")[0].split()[:3])
        self.left_out.append(LeftOut(entry.line, what[:80], why))
        if entry.keyword in _READING:
            self._lose_signal(entry)

    def _lose_signal(self, entry: Entry) -> None:
        """Mark as unusable the signal that an entry of `_READING` names."""
        _, digits, *words = [*re.findall(r"\w+", entry.text), "", ""]
        number = number_of(digits) if digits.isdecimal() else -1
        signals = self._known.get(number, {})
        name = next((word for word in words if word), "")
        if name in signals:
            why = f"its {entry.keyword} (line {entry.line}) cannot be used"
            self.unusable.setdefault((number, name), why)

    def _marked(self, entry: Entry) -> Entry:
        """The entry with bit 31 in its message's number if that has more than 11 bits."""
        match = _NUMBER.match(entry.text)
        number = number_of(match[1]) if match else -1
        if match is None or not _ELEVEN_BITS < number < _MARK >> 2:
            return entry
        if entry.keyword == "BO_":
            self._list(entry, "bit 31, which marks 29 bits, is missing: read as 29 bits")
        text = f"{entry.text[: match.start(1)]}{number | _MARK}{entry.text[match.end(1) :]}"
        return entry._replace(text=text)

    def _is_foreign(self, entry: Entry) -> bool:
        if entry.keyword:
            return False
        more = entry.text.count("\n")
        lines = f", nor are the lines up to {entry.line + more}" if more else ""
        why = f"not an entry of a DBC{lines}"
        self.left_out.append(LeftOut(entry.line, entry.text.split("\n")[0].strip()[:80], why))
        return True

    def _check_messages(self) -> None:
        """Check the form of messages and signals."""
        kept: list[Entry] = []
        number: int | None = None
        lost = False
        for entry in self.entries:
            if entry.keyword == "BO_":
                found = message_of(entry.text)
                number, lost = self._message(entry, found), True
                if number is not None:
                    kept.append(entry._replace(text=found.text))
            elif entry.keyword != "SG_":
                number, lost = (number, lost) if entry.keyword == "BO_TX_BU_" else (None, False)
                kept.append(entry)
            elif number is not None:
                kept += self._signal(entry, number)
            elif not lost:
                self._list(entry, "does not follow a message")
        self.entries = kept

    def _message(self, entry: Entry, found: Checked) -> int | None:
        """Number of the message, or None if it is left out."""
        # Editors keep signals that belong to no message in a message of this name.
        unused = found.name == _INDEPENDENT
        if not (found.fault or unused) and found.number is not None:
            self._known.setdefault(found.number, {})
            return found.number
        self._gone |= {found.number} if found.number is not None else set()
        if not unused:
            self._list(entry, found.fault)
        return None

    def _signal(self, entry: Entry, number: int) -> list[Entry]:
        """The entry to use for a signal, in a list; empty if there is none."""
        found: Checked | None = signal_of(entry.text)
        assert found is not None
        if found.fault:
            self._list(entry, found.fault)
            found = stand_in(entry.text)
            if found is None or found.name in self._known[number]:
                return []
            self.unusable[number, found.name] = "cannot be read"
            self.listed.add((number, found.name))
        elif (number, found.name) in self.listed:
            # Two signals of one name: `tolerant` leaves them out.
            self.listed.discard((number, found.name))
        self._known[number][found.name] = found.size
        if found.marker.startswith("m"):
            self.multiplexed.add((number, found.name))
        return [entry._replace(text=found.text)]

    def _checked(self, entry: Entry) -> Entry | None:
        """The entry, possibly with another text; None if it is left out."""
        bare = re.sub(TEXT, "", entry.text)
        if entry.keyword in ENDED and not (bare.endswith(";") and '"' not in bare):
            self._list(entry, "does not end in a semicolon, or its quotes do not match")
            return None
        if match := _ABOUT.match(entry.text):
            signals = self._known.get(number_of(match[2] or match[4]))
            named = match[1] == "SG_" and match[3]
            # Entries about a message or signal that is not in the file are dropped unlisted.
            return None if signals is None or (named and match[3] not in signals) else entry
        match = _REFERENCE.match(entry.text)
        if match is not None and entry.keyword != "SIG_GROUP_":
            return self._of_signal(entry, number_of(match[1]), match[2])
        if entry.keyword != "SG_" and _DIGITS.search(bare):
            self._list(entry, "a number with more than 300 digits")
            return None
        return entry

    def _of_signal(self, entry: Entry, number: int, name: str) -> Entry | None:
        """A VAL_, SIG_VALTYPE_ or SG_MUL_VAL_ entry as it is used; None if it is left out."""
        size = self._known.get(number, {}).get(name)
        if size is None:
            if number not in self._gone:
                self._list(entry, "of a signal that the file does not have")
            return None
        if (number, name) in self.listed and entry.keyword != "SG_MUL_VAL_":
            return None
        if entry.keyword == "VAL_":
            why, text = labels_of(entry.text)
            if why:
                self._list(entry, why)
            return entry._replace(text=text)
        if entry.keyword == "SIG_VALTYPE_":
            why, text = value_type_of(entry.text, size)
        else:
            why, text = multiplexing_of(entry.text)
        if why:
            self._list(entry, why)
            return None
        return entry._replace(text=text)

    def _check_attributes(self) -> None:
        found = {id(fault.entry): fault for fault in attributes.faults(self.entries)}
        kept: list[Entry] = []
        for entry in self.entries:
            fault = found.get(id(entry))
            if fault is None:
                kept.append(entry)
                continue
            if fault.why:
                self._list(entry, fault.why)
            if fault.mended is not None:
                kept.append(entry._replace(text=fault.mended))
        self.entries = kept


def text_of(entries: Sequence[Entry]) -> str:
    """Text of a DBC file with these entries.

    It is never empty, and ends with a further keyword: else cantools accepts half an entry.
    """
    return "\n".join(["BS_:", *(entry.text for entry in entries), "BS_:", ""])
