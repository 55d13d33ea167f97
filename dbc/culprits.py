"""Load a DBC with cantools; entries that it rejects are found by trial and left out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.entries import Entries, text_of
from dbc.entry_text import Entry
from dbc.load_errors import SYNTAX, one_line, quiet
from dbc.spec import DbcMismatch

if TYPE_CHECKING:
    from cantools.database import Database

_MOST_LOADS: Final = 100
"""Most loads to find well-formed entries that cantools rejects; each of them needs several."""
_MEANING: Final = frozenset({"VERSION", "BS_", "BU_", "BO_", "SG_", "SIG_VALTYPE_", "SG_MUL_VAL_"})
_MESSAGE: Final = Entry(0, "BO_", "BO_ 0 M: 8 N")
_SHOWN: Final = 40


def load_rest(path: Path, entries: Entries) -> Database:
    """Load with cantools; entries that it rejects are left out. Raises DbcMismatch."""
    found = _load(entries.entries)
    if not isinstance(found, str):
        return found
    first = found
    if SYNTAX.search(found):
        entries.drop(_malformed(entries.entries))
    for _ in range(_MOST_LOADS // (len(entries.entries).bit_length() + 1)):
        found = _load(entries.entries)
        if not isinstance(found, str):
            return found
        entry, why = _first_not_taken(entries.entries)
        entries.drop([(entry, f"cannot be used ({why})")])
    for keywords in (_MEANING | {"VAL_"}, _MEANING):
        found = _load(entries.entries)
        if not isinstance(found, str):
            return found
        entries.drop([(e, found) for e in entries.entries if e.keyword not in keywords])
    found = _load(entries.entries)
    if isinstance(found, str):
        raise DbcMismatch(path, [first])
    return found


def _load(entries: Sequence[Entry]) -> Database | str:
    """Load with cantools; return its error message, in one line, if it rejects the entries."""
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        with quiet():
            return load_string(  # type: ignore[return-value]
                text_of(entries), "dbc", strict=False
            )
    except Error as error:
        return one_line(error)
    except Exception as error:  # cantools lets bare KeyErrors and others escape
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _malformed(entries: Sequence[Entry]) -> list[tuple[Entry, str]]:
    """All entries that do not fit cantools' grammar, each with the place of its error.

    The list is searched by halves, so that the time grows with the size of the file and not with
    the number of such entries.
    """
    out: list[tuple[Entry, str]] = []
    parts = [list(entries)]
    while parts:
        part = parts.pop()
        # cantools reads a signal only inside a message.
        fault = _load([_MESSAGE, *part] if part[0].keyword == "SG_" else part)
        place = SYNTAX.search(fault) if isinstance(fault, str) else None
        if place is None:
            continue
        if len(part) == 1:
            out.append((part[0], _where(part[0], int(place[1]), int(place[2]))))
            continue
        half = len(part) // 2
        parts += [part[half:], part[:half]]
    return out


def _where(entry: Entry, line: int, column: int) -> str:
    """Where an entry becomes unreadable; line, column: in a file with only this entry."""
    lines = entry.text.split("\n")
    at = line - 2 - (entry.keyword == "SG_")
    rest = lines[at][column - 1 :].strip() if 0 <= at < len(lines) else ""
    return f"cannot be read from {rest[:_SHOWN]!r} on" if rest else "cannot be read to its end"


def _first_not_taken(entries: Sequence[Entry]) -> tuple[Entry, str]:
    """The first entry that makes a file of it and all entries before it unreadable, and why."""
    good, bad = 0, len(entries)
    why = _load(entries)
    while bad - good > 1:
        half = (good + bad) // 2
        found = _load(entries[:half])
        if isinstance(found, str):
            bad, why = half, found
        else:
            good = half
    return entries[bad - 1], str(why)
