"""Load a DBC file as message specs, with all objections in one list.

cantools reads the file. This module finds the faults that cantools does not report (duplicate
names and ids) or reports one at a time (layout), and compares the messages with the contract.
Nothing here is used after start-up.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dbc import contract as expected
from dbc.contract import Contract, MessageNeed, SignalNeed
from dbc.generate import recall
from dbc.layout import duplicates, layout_faults, oversized
from dbc.load_errors import explained, one_line, placed, quiet
from dbc.message_spec import is_long, message_spec
from dbc.spec import DbcMismatch, MessageSpec, SignalSpec
from dbc.text import decoded, read_bytes

if TYPE_CHECKING:
    from cantools.database import Database


def load(path: Path, *, strict: bool = True) -> Database:
    """Read a DBC with cantools. Raises DbcMismatch if the file is missing or is not a DBC."""
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        text = read_bytes(path)
        impossible = list(oversized(text))
    except FileNotFoundError:
        raise DbcMismatch(path, ["no such file"]) from None
    except (OSError, ValueError) as error:
        # A name with a NUL, which a TOML string may contain, raises ValueError.
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcMismatch(path, [f"cannot be read: {reason}"]) from None
    if impossible:
        raise DbcMismatch(path, impossible)
    try:
        with quiet():
            return load_string(decoded(text), "dbc", strict=strict)  # type: ignore[return-value]
    except Error as error:
        raise DbcMismatch(path, explained(one_line(error), text)) from None
    except Exception as error:  # cantools lets bare KeyErrors and others escape
        why = f"cannot be read as a DBC: {type(error).__name__}: {one_line(error)}"
        raise DbcMismatch(path, [why]) from None


def specs_of(
    path: Path, nodes: Sequence[int], contract: Contract | None
) -> tuple[MessageSpec, ...]:
    """Every message of the file as a spec. Raises DbcMismatch with all objections."""
    problems: list[str] = []
    try:
        specs = recall(read_bytes(path))
    except (OSError, ValueError):
        # `load` reports what is wrong with the file.
        specs = None
    if specs is None:
        specs, problems = read(path)
    chosen = contract or choose(specs, nodes)
    problems += compare(specs, tuple(nodes), chosen)
    if problems:
        raise DbcMismatch(path, problems)
    return specs


def read(path: Path) -> tuple[tuple[MessageSpec, ...], list[str]]:
    """Every message of the file, read by cantools, and the faults of the file itself.

    Raises DbcMismatch for a file that cantools cannot read at all.
    """
    problems: list[str] = []
    refusal: tuple[str, ...] = ()
    try:
        database = load(path)
    except DbcMismatch as refused:
        # Load again without the layout check, to list all faults of layout at once.
        try:
            database = load(path, strict=False)
        except DbcMismatch:
            raise refused from None
        refusal = refused.problems
        text = path.read_bytes()
        problems += [placed(fault, text) for fault in layout_faults(database)]
    messages = [m for m in database.messages if hasattr(m, "frame_id")]
    problems += duplicates(messages)
    if not problems:
        problems += refusal
    specs: list[MessageSpec] = []
    long = any(map(is_long, messages))
    for message in messages:
        spec, faults, unusable = message_spec(database, message, len(specs), long=long)
        specs.append(spec)
        problems += faults + [f"{spec.name}.{name}: {why}" for name, why in unusable.items()]
        problems += (
            f"{spec.name}.{s.name}: not-available code {s.not_available} lies inside the range"
            for s in spec.signals
            if s.not_available is not None
            and s.raw_min <= s.not_available <= s.raw_max
            and s.raw_max - s.raw_min < (1 << s.length) - 1
        )
    return tuple(specs), problems


def choose(specs: Collection[MessageSpec], nodes: Sequence[int]) -> Contract:
    """The FD contract if one of `nodes` (if empty: any drive) has `Samples`, else the classic."""
    fd = any(s.kind == "Samples" and (not nodes or s.node in nodes) for s in specs)
    return expected.FD if fd else expected.CLASSIC


def compare(
    specs: Collection[MessageSpec], nodes: tuple[int, ...], contract: Contract
) -> Iterator[str]:
    """Yield the objections to the messages of these nodes."""
    by_name = {spec.name: spec for spec in specs}
    for name, need, _ in contract.named(nodes):
        spec = by_name.get(name)
        if spec is None:
            if not need.optional:
                yield f"{name}: message missing"
            continue
        yield from (f"{name}: {fault}" for fault in _compare_message(spec, need))
        signals: Mapping[str, SignalSpec] = {signal.name: signal for signal in spec.signals}
        for wanted in need.signals:
            signal = signals.get(wanted.name)
            if signal is None:
                yield f"{name}.{wanted.name}: signal missing"
            else:
                faults = _compare_signal(signal, wanted)
                yield from (f"{name}.{wanted.name}: {fault}" for fault in faults)


def _compare_message(spec: MessageSpec, need: MessageNeed) -> Iterator[str]:
    if spec.is_extended:
        yield "29-bit id; the message set uses 11-bit ids"
    if spec.is_fd != need.fd:
        kinds = ("classic CAN", "CAN FD")
        yield f"is {kinds[spec.is_fd]}, expected {kinds[need.fd]} (VFrameFormat)"
    if spec.length != need.length:
        yield f"{spec.length} bytes, expected {need.length}"
    if need.cyclic and not spec.cycle_ns:
        yield "no cycle time (GenMsgCycleTime)"


def _compare_signal(signal: SignalSpec, need: SignalNeed) -> Iterator[str]:
    if signal.unit != need.unit:
        yield f"unit {signal.unit!r}, expected {need.unit!r}"
    if signal.is_float and (need.codes or need.bits):
        yield "is a float, expected a whole number"
    if need.bits and signal.length != need.bits:
        yield f"{signal.length} bits, expected {need.bits}"
    if signal.mux_parent is not None:
        yield f"is multiplexed by {signal.mux_parent}, expected in every frame"
    if need.codes:
        if (signal.scale, signal.offset) != (1, 0):
            yield f"scale {signal.scale}, offset {signal.offset}; states are not scaled"
        for raw, label in need.codes.items():
            found = signal.labels.get(raw, label)
            if found != label:
                yield f"{raw} means {found!r}, expected {label!r}"
            if not signal.raw_min <= raw <= signal.raw_max:
                yield f"{raw} ({label}) is outside the range {signal.raw_min}..{signal.raw_max}"
