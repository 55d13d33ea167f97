"""Read the usable part of a DBC, and list the rest with line and reason.

This is for foreign DBCs: a wrong entry only costs that entry. `dbc.load.read` reads our own message
set, which a single objection makes unusable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.culprits import load_rest
from dbc.entries import Entries
from dbc.layout import bits_of
from dbc.message_spec import chain_end, is_long, message_spec
from dbc.spec import DbcMismatch, MessageSpec, Profile
from dbc.text import decoded, read_bytes

if TYPE_CHECKING:
    from cantools.database import Database


_CONVERTED: Final = "; make one of it: `cantools convert FILE OUT.dbc`"
_CURES: Final = {
    ".arxml": _CONVERTED, ".kcd": _CONVERTED, ".sym": _CONVERTED,
    ".eds": "; `check --eds` takes an EDS", ".dbf": "; BUSMASTER and canmatrix export DBF as DBC",
}  # fmt: skip
"""What to do with a file of another kind."""


def read_any_dbc(path: Path) -> tuple[tuple[MessageSpec, ...], list[str]]:
    """The usable messages, numbered, and notes on all that is left out or changed.

    Raises DbcMismatch if there is no such file, or no DBC entry in it.
    """
    database, entries = _read(path)
    lines = entries.lines()
    notes = [str(left) for left in sorted(entries.left_out)]
    reasons = _Reasons(entries)
    specs: dict[tuple[int, bool], MessageSpec] = {}
    messages = [message for message in database.messages if hasattr(message, "frame_id")]
    long = any(map(is_long, messages))
    for message in messages:
        spec, faults, unusable = message_spec(database, message, 0, long=long)
        notes += [_placed(lines, f"{fault}; ignored") for fault in faults]
        known, listed = reasons.for_message(spec)
        spec, dropped = _usable(spec, known | unusable, listed)
        notes += [_placed(lines, fault) for fault in dropped]
        if (spec.can_id, spec.is_extended) in specs:
            other = specs.pop((spec.can_id, spec.is_extended))
            notes.append(_placed(lines, f"{other.name}: {spec.name} has the same identifier"))
        specs[spec.can_id, spec.is_extended] = spec
    named, renamed = _named(list(specs.values()))
    notes += [_placed(lines, fault) for fault in renamed]
    return tuple(replace(spec, index=k) for k, spec in enumerate(named)), notes


def database_of(path: Path) -> Database:
    """The file as cantools reads it, without entries that it rejects. Raises DbcMismatch."""
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
    if not entries.entries:
        cure = _CURES.get(path.suffix.lower(), "")
        raise DbcMismatch(path, [f"is not a DBC: there is no entry of one in it{cure}"])
    return load_rest(path, entries), entries


class _Reasons:
    """Reasons in the file why signals cannot be used, by message."""

    def __init__(self, entries: Entries) -> None:
        self._long = entries.long_names()
        self._unusable = self._by_message(entries.unusable)
        self._listed = self._by_message(dict.fromkeys(entries.listed, ""))
        self._multiplexed = self._by_message(dict.fromkeys(entries.multiplexed, ""))

    def for_message(self, spec: MessageSpec) -> tuple[dict[str, str], frozenset[str]]:
        """The reasons by signal name, and the names of the signals that are listed already."""
        reasons = dict(self._unusable.get(spec.key, {}))
        marked = self._multiplexed.get(spec.key, {})
        for signal in spec.signals:
            if signal.name in marked and signal.mux_parent is None:
                why = "is multiplexed, and the file does not say by which signal"
                reasons.setdefault(signal.name, why)
        return reasons, frozenset(self._listed.get(spec.key, ()))

    def _by_message(self, found: Mapping[tuple[int, str], str]) -> dict[int, dict[str, str]]:
        out: dict[int, dict[str, str]] = {}
        for (number, name), why in found.items():
            out.setdefault(number, {})[self._long.get((number, name), name)] = why
        return out


def _usable(
    spec: MessageSpec, unusable: dict[str, str], listed: frozenset[str]
) -> tuple[MessageSpec, list[str]]:
    """The message without signals that cannot be decoded or are multiplexed by such a signal.

    Returns it with the problems; listed: signals that must not be listed again.
    """
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
        lost = {name: parent for name, parent in parents.items() if chain_end(name, parents)}
        if not lost:
            break
        reasons |= {name: f"is multiplexed by {parent}" for name, parent in lost.items()}
    problems = [f"{spec.name}.{name}: {why}" for name, why in reasons.items()
                if name not in listed]  # fmt: skip
    # The dropped signals may include the E2E header; a foreign file is not checked anyway.
    return replace(spec, signals=tuple(kept), profile=Profile.NONE, data_ids=b""), problems


def _named(specs: list[MessageSpec]) -> tuple[list[MessageSpec], list[str]]:
    """The messages with distinct names, and a note for each that is renamed."""
    taken: set[str] = set()
    out, notes = [], []
    for spec in specs:
        name, k = spec.name, 2
        while name in taken:
            name, k = f"{spec.name}_{k}", k + 1
        if name != spec.name:
            notes.append(
                f"{spec.name}: another message has this name; columns of this one are named {name}"
            )
        taken.add(name)
        out.append(spec if name == spec.name else replace(spec, name=name, kind=name))
    return out, notes


def _placed(lines: dict[str, int], fault: str) -> str:
    """The fault, with its line in front if that is known."""
    line = lines.get(fault.partition(":")[0])
    return f"line {line}: {fault}" if line else fault
