"""Whatever of a DBC can be used, and a list of what cannot, with line and reason.

For DBCs of others: one entry that is wrong costs that entry. Our own message set is read by
`dbc.load.read`, to which one objection is enough.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.e2e import Profile
from dbc.entries import Entries, Entry
from dbc.layout import bits_of
from dbc.message_spec import message_spec
from dbc.spec import DbcMismatch, MessageSpec
from dbc.text import decoded, read_bytes

if TYPE_CHECKING:
    from cantools.database import Database

_PLACE: Final = re.compile(r"line (\d+), column \d+")
_UNUSED: Final = re.compile(r"VAL_ (\d+) (\w+)")
_TRIES: Final = 24
_MEANING: Final = frozenset(
    {"VERSION", "NS_", "BS_", "BU_", "BO_", "SG_", "SIG_VALTYPE_", "SG_MUL_VAL_"}
)
_ATTRIBUTES: Final = frozenset({"BA_DEF_", "BA_DEF_DEF_", "BA_"})


def read_any_dbc(path: Path) -> tuple[tuple[MessageSpec, ...], list[str]]:
    """Messages that can be used, numbered, and what is left out or changed of the others.

    Raises DbcMismatch if there is no such file, or nothing of a DBC in it.
    """
    database, entries = _read(path)
    lines = _lines_of(entries.text)
    notes = [str(left) for left in sorted(entries.left_out)]
    specs: dict[tuple[int, bool], MessageSpec] = {}
    for message in database.messages:
        if not hasattr(message, "frame_id"):
            continue
        spec, faults, unusable = message_spec(database, message, 0)
        notes += [_placed(lines, f"{fault}; ignored") for fault in faults]
        spec, dropped = _usable(spec, unusable)
        notes += [_placed(lines, fault) for fault in dropped]
        if (spec.can_id, spec.is_extended) in specs:
            other = specs.pop((spec.can_id, spec.is_extended))
            notes.append(_placed(lines, f"{other.name}: {spec.name} has the same identifier"))
        specs[spec.can_id, spec.is_extended] = spec
    named, renamed = _named(list(specs.values()))
    notes += [_placed(lines, fault) for fault in renamed]
    return tuple(replace(spec, index=k) for k, spec in enumerate(named)), notes


def database_of(path: Path) -> Database:
    """The file by cantools, without entries that it does not take. Raises DbcMismatch."""
    return _read(path)[0]


def _read(path: Path) -> tuple[Database, Entries]:
    try:
        text = decoded(read_bytes(path))
    except FileNotFoundError:
        raise DbcMismatch(path, ["no such file"]) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcMismatch(path, [f"cannot be read: {reason}"]) from None
    entries = Entries(text.replace("\r\n", "\n").replace("\r", "\n"))
    return _loaded(path, entries), entries


def _loaded(path: Path, entries: Entries) -> Database:
    """By cantools; entries that it does not take are left out one by one."""
    from cantools.database import load_string
    from cantools.database.errors import Error

    quiet = logging.getLogger("cantools.database.can.database")
    before = quiet.level
    quiet.setLevel(logging.ERROR)
    first = ""
    try:
        for _ in range(_TRIES):
            try:
                return load_string(entries.text, "dbc", strict=False)  # type: ignore[return-value]
            except Error as error:
                why = " ".join(str(error).split()).removeprefix("DBC: ").strip('"')
            except Exception as error:  # cantools lets bare KeyErrors and others escape
                why = f"{type(error).__name__}: {' '.join(str(error).split())}"
            first = first or why
            unused = frozenset(_UNUSED.findall(why))
            if unused and entries.drop_all(
                partial(_is_table_of, unused), "of no signal", each=True
            ):
                continue
            place = _PLACE.search(why)
            if place and entries.drop_line(int(place[1]), f"cannot be read ({why})"):
                continue
            if entries.drop_all(lambda e: e.keyword in _ATTRIBUTES, f"attributes: {why}"):
                continue
            if entries.drop_all(lambda e: e.keyword not in _MEANING | {"VAL_"}, why):
                continue
            if entries.drop_all(lambda e: e.keyword not in _MEANING, why):
                continue
            break
    finally:
        quiet.setLevel(before)
    raise DbcMismatch(path, [first])


def _is_table_of(names: frozenset[tuple[str, str]], entry: Entry) -> bool:
    """Whether it is a value table of one of these messages and signals."""
    match = re.match(r"\s*VAL_\s+(\d+)\s+(\w+)", entry.text)
    return match is not None and (match[1], match[2]) in names


def _usable(spec: MessageSpec, unusable: dict[str, str]) -> tuple[MessageSpec, list[str]]:
    """The message without signals that cannot be decoded, and those that hang on them."""
    reasons = dict(unusable)
    for name, count in Counter(signal.name for signal in spec.signals).items():
        if count > 1:
            reasons.setdefault(name, f"defined {count} times")
    for signal in spec.signals:
        if bits_of(signal, signal.is_big_endian)[-1] >= 8 * spec.length:
            reasons.setdefault(signal.name, f"does not fit in {spec.length} bytes")
    while True:
        kept = [signal for signal in spec.signals if signal.name not in reasons]
        parents = {signal.name: signal.mux_parent for signal in kept}
        lost = {name: parent for name, parent in parents.items() if _hangs(name, parents)}
        if not lost:
            break
        reasons |= {name: f"is multiplexed by {parent}" for name, parent in lost.items()}
    problems = [f"{spec.name}.{name}: {why}" for name, why in reasons.items()]
    # What protects it may be among them; nothing is checked in a file of others.
    return replace(spec, signals=tuple(kept), profile=Profile.NONE, data_ids=b""), problems


def _hangs(name: str, parents: dict[str, str | None]) -> bool:
    """Whether its selector is not there, or is itself."""
    seen = {name}
    at = parents[name]
    while at is not None:
        if at not in parents or at in seen:
            return True
        seen.add(at)
        at = parents[at]
    return False


def _named(specs: list[MessageSpec]) -> tuple[list[MessageSpec], list[str]]:
    """Messages whose names differ."""
    taken: set[str] = set()
    out, notes = [], []
    for spec in specs:
        name, k = spec.name, 2
        while name in taken:
            name, k = f"{spec.name}_{k}", k + 1
        if name != spec.name:
            notes.append(f"{spec.name}: another message has this name; its columns are {name}'s")
        taken.add(name)
        out.append(spec if name == spec.name else replace(spec, name=name, kind=name))
    return out, notes


def _lines_of(text: str) -> dict[str, int]:
    """Line of `Message` and `Message.Signal`."""
    found: dict[str, int] = {}
    message = ""
    for number, line in enumerate(text.split("\n"), 1):
        if match := re.match(r"\s*BO_\s+\d+\s+(\w+)", line):
            message = match[1]
            found.setdefault(message, number)
        elif match := re.match(r"\s*SG_\s+(\w+)", line):
            found.setdefault(f"{message}.{match[1]}", number)
    return found


def _placed(lines: dict[str, int], fault: str) -> str:
    """With its line in front."""
    line = lines.get(fault.partition(":")[0])
    return f"line {line}: {fault}" if line else fault
