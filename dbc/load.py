"""From a DBC file to message specs, with every objection in one list.

cantools reads the file; what it lets pass in silence (duplicate names and ids) or reports one
at a time (layout) is looked for here. Nothing in this module is used after start-up.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dbc import contract as expected
from dbc.contract import Contract, Direction, MessageNeed, SignalNeed
from dbc.dataids import p02_data_ids
from dbc.e2e import HEADER_BYTES, Profile
from dbc.generate import recall
from dbc.layout import bits_of, duplicates, layout_faults, oversized
from dbc.load_errors import explained, placed
from dbc.spec import DbcMismatch, MessageSpec, SignalSpec
from dbc.text import decoded, read_bytes

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message, Signal

_NAME: Final = re.compile(r"(?:Drive(\d{1,2})|Gateway)_(\w+)")
_NO_DATA_LABELS: Final = frozenset({"notavailable", "notavail", "na", "sna"})
_HEADERS: Final = {
    Profile.P02: (("Crc", 0, 8), ("Counter", 8, 4)),
    Profile.P05: (("Crc", 0, 16), ("Counter", 16, 8)),
}
_PROFILES: Final = {"none": Profile.NONE, "p02": Profile.P02, "p05": Profile.P05}
_PRODUCED: Final = frozenset(
    (need.kind, need.per_drive)
    for need in expected.CLASSIC.messages
    if need.direction is Direction.PRODUCED
)
_LONGEST_CYCLE_MS: Final = 3_600_000
# A DBC decimal times a power of two is off by a few ulp; raw bounds are whole numbers.
_SLACK: Final = 1e-6


def load(path: Path, *, strict: bool = True) -> Database:
    """Read a DBC with cantools. Raises DbcMismatch if there is no such file or it is no DBC."""
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        text = read_bytes(path)
        impossible = list(oversized(text))
    except FileNotFoundError:
        raise DbcMismatch(path, ["no such file"]) from None
    except (OSError, ValueError) as error:
        # ValueError: a NUL in the name, which a TOML string may hold.
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcMismatch(path, [f"cannot be read: {reason}"]) from None
    if impossible:
        raise DbcMismatch(path, impossible)
    quiet = logging.getLogger("cantools.database.can.database")
    before = quiet.level
    # Duplicates only make it log; they are listed properly by `dbc.layout`.
    quiet.setLevel(logging.ERROR)
    try:
        database = load_string(decoded(text), "dbc", strict=strict)
    except Error as error:
        raise DbcMismatch(path, explained(_one_line(error), text)) from None
    except Exception as error:  # cantools lets bare KeyErrors and others escape
        why = f"cannot be read as a DBC: {type(error).__name__}: {_one_line(error)}"
        raise DbcMismatch(path, [why]) from None
    finally:
        quiet.setLevel(before)
    return database  # type: ignore[return-value]


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split()).removeprefix("DBC: ")
    return text.strip('"') or type(error).__name__


def specs_of(
    path: Path, nodes: Sequence[int], contract: Contract | None
) -> tuple[MessageSpec, ...]:
    """Every message of the file as a spec. Raises DbcMismatch with all objections."""
    problems: list[str] = []
    try:
        specs = recall(read_bytes(path))
    except (OSError, ValueError):
        # `load` says what is wrong with it.
        specs = None
    if specs is None:
        specs, problems = read(path)
    chosen = contract or choose(specs, nodes)
    problems += _compare(specs, tuple(nodes), chosen)
    if problems:
        raise DbcMismatch(path, problems)
    return specs


def read(path: Path) -> tuple[tuple[MessageSpec, ...], list[str]]:
    """Every message of the file by cantools, and what is wrong in the file itself.

    Raises DbcMismatch for a file that cantools cannot read at all.
    """
    problems: list[str] = []
    refusal: tuple[str, ...] = ()
    try:
        database = load(path)
    except DbcMismatch as refused:
        # Once more without the layout check, to list every fault of layout at once.
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
    for message in messages:
        spec, faults, unusable = message_spec(database, message, len(specs))
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
    """The FD contract if a wanted drive (or any, if none is wanted) has `Samples`."""
    fd = any(s.kind == "Samples" and (not nodes or s.node in nodes) for s in specs)
    return expected.FD if fd else expected.CLASSIC


# ---- specs -------------------------------------------------------------------------------------


def _attribute(database: Database, message: Message, name: str) -> Any:
    """Value of a message attribute, enumerations by name; None where not defined."""
    specifics = database.dbc
    definition = specifics.attribute_definitions.get(name) if specifics else None
    own = message.dbc.attributes.get(name) if message.dbc and message.dbc.attributes else None
    if definition is None:
        return own.value if own is not None else None
    value = own.value if own is not None else definition.default_value
    if definition.type_name == "ENUM" and isinstance(value, int):
        choices = definition.choices or []
        return choices[value] if 0 <= value < len(choices) else f"number {value}"
    return value


def message_spec(
    database: Database, message: Message, index: int
) -> tuple[MessageSpec, list[str], dict[str, str]]:
    """The message; what is wrong with it; signals that cannot be decoded, and why.

    What is wrong is not in the spec: a range that cannot be is none, a cycle time 0.
    """
    problems: list[str] = []
    signals = []
    unusable: dict[str, str] = {}
    for signal in message.signals:
        spec, faults, why = _signal_spec(signal)
        signals.append(spec)
        problems += (f"{message.name}.{signal.name}: {fault}" for fault in faults)
        if why:
            unusable[signal.name] = why
    profile, ids, faults = _protection(database, message)
    problems += (f"{message.name}: {fault}" for fault in faults)
    problems += _header(message.name, profile, signals)
    problems += _selectors(message.name, signals)
    match = _NAME.fullmatch(message.name)
    node = int(match[1] or 0) if match else 0
    kind = match[2] if match else message.name
    brs = _attribute(database, message, "CANFD_BRS")
    cycle = message.cycle_time or 0
    if not isinstance(cycle, (int, float)) or not 0 <= cycle <= _LONGEST_CYCLE_MS:
        problems.append(f"{message.name}: GenMsgCycleTime {cycle!r} is not a time in ms")
        cycle = 0
    return (
        MessageSpec(
            name=message.name,
            can_id=message.frame_id,
            length=message.length,
            is_fd=message.is_fd,
            # Vector's default, where the attribute is not there, is with bit rate switch.
            brs=message.is_fd and str(1 if brs is None else brs) == "1",
            cycle_ns=round(cycle * 1_000_000),
            profile=profile,
            data_ids=ids,
            signals=tuple(signals),
            index=index,
            node=node,
            kind=kind,
            is_extended=message.is_extended_frame,
            is_gateway=match is not None and (kind, node > 0) in _PRODUCED,
        ),
        problems,
        unusable,
    )


def _selectors(name: str, signals: Sequence[SignalSpec]) -> Iterator[str]:
    """What a signal is multiplexed by must be there, and end somewhere."""
    parents = {signal.name: signal.mux_parent for signal in signals}
    for signal in signals:
        at, seen = signal.mux_parent, {signal.name}
        while at in parents and at not in seen:
            seen.add(at)
            at = parents[at]
        if at in seen:
            yield f"{name}.{signal.name}: is multiplexed by itself"
        elif at is not None:
            yield f"{name}.{signal.name}: is multiplexed by {at}, which the message does not have"


def _signal_spec(signal: Signal) -> tuple[SignalSpec, list[str], str]:
    """The signal; what is wrong with it and left out; why it cannot be decoded, or ""."""
    problems: list[str] = []
    unusable = ""
    low, high = (
        (-(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1)
        if signal.is_signed
        else (0, (1 << signal.length) - 1)
    )
    scale, offset = signal.conversion.scale, signal.conversion.offset
    if not scale or not math.isfinite(scale) or not math.isfinite(offset):
        unusable = f"scale {scale}, offset {offset} cannot be inverted"
        scale = 1.0
    if signal.is_float and signal.length not in (32, 64):
        unusable = f"a float of {signal.length} bits is not supported"
    labels = {}
    for raw, label in (signal.choices or {}).items():
        # Tools write the code of a signed signal as the unsigned number of its bits.
        wrapped = (
            int(raw) - (1 << signal.length) if signal.is_signed and int(raw) > high else int(raw)
        )
        labels[wrapped] = str(label)
    raw_min, raw_max = low, high
    float_min, float_max = SignalSpec.float_limits()
    bounds = (signal.minimum, signal.maximum)
    # Equal ones are how many tools write that there is no range.
    if bounds[0] is not None and bounds[1] is not None and bounds[0] != bounds[1]:
        minimum, maximum = float(bounds[0]), float(bounds[1])
        if minimum > maximum:
            problems.append(f"range {minimum:g}..{maximum:g} is empty")
        elif signal.is_float:
            float_min, float_max = max(minimum, float_min), min(maximum, float_max)
        else:
            ends = sorted(((minimum - offset) / scale, (maximum - offset) / scale))
            # Bounds beyond the type's (infinite ones too) are the type's.
            raw_min = max(low, math.ceil(min(max(ends[0], low), high + 1) - _SLACK))
            raw_max = min(high, math.floor(max(min(ends[1], high), low - 1) + _SLACK))
            if raw_min > raw_max:
                problems.append(f"range {minimum:g}..{maximum:g} holds no raw value")
                raw_min, raw_max = low, high
    code = _not_available(labels, (raw_min, raw_max), (low, high))
    if code is not None and not low <= code <= high:
        problems.append(f"not-available code {code} does not fit in {signal.length} bits")
        code = None
    start_raw, fault = _start(signal, low, high)
    problems += fault
    return (
        SignalSpec(
            name=signal.name,
            start=signal.start,
            length=signal.length,
            is_signed=signal.is_signed,
            is_big_endian=signal.byte_order == "big_endian",
            scale=scale,
            offset=offset,
            unit=signal.unit or "",
            raw_min=raw_min,
            raw_max=raw_max,
            not_available=code,
            start_raw=start_raw,
            labels=labels,
            is_float=signal.is_float,
            float_min=float_min,
            float_max=float_max,
            mux_parent=signal.multiplexer_signal,
            mux_ranges=_runs(signal.multiplexer_ids or ()),
        ),
        problems,
        unusable,
    )


def _start(signal: Signal, low: int, high: int) -> tuple[int, list[str]]:
    """Raw start value; a not given or (for floats) fractional one is 0."""
    raw = signal.raw_initial
    if raw is None or signal.is_float:
        return 0, []
    if isinstance(raw, float) and not raw.is_integer():
        return 0, [f"start value {raw} is not a raw (whole) number"]
    if not low <= raw <= high:
        return 0, [f"start value {raw} does not fit in {signal.length} bits"]
    return int(raw), []


def _not_available(
    labels: Mapping[int, str], raw_range: tuple[int, int], limits: tuple[int, int]
) -> int | None:
    """The raw value that says that there is none, if a label says so of one.

    At the end of the raw limits, or with all bits set, such a label is that code. Elsewhere it is
    one only where no other label names a state, or outside of the range: "NA", which may be a
    country, not even there. Of several the highest: `Reason` has a cause called NotAvailable below
    its own code.
    """
    low, high = limits
    found = [raw for raw, text in labels.items() if _says_no_data(text)]
    edge = [raw for raw in found if raw == high or (low < 0 and raw in (-1, low))]
    if edge:
        return max(edge)
    if all(map(_is_special, labels.values())):
        return max(found, default=None)
    first, last = raw_range
    sure = [raw for raw in found if not first <= raw <= last and labels[raw].lower() != "na"]
    return max(sure, default=None)


def _says_no_data(label: str) -> bool:
    return re.sub(r"[\W_]", "", label).lower() in _NO_DATA_LABELS


def _is_special(label: str) -> bool:
    """Whether a label is of no state: no data, an error, not yet valid."""
    return (
        _says_no_data(label)
        or re.search(r"err|fault|invalid|init|unknown|reserved", label, re.I) is not None
    )


def _runs(values: Collection[int]) -> tuple[tuple[int, int], ...]:
    """Sorted numbers as inclusive runs."""
    runs: list[list[int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][1] + 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    return tuple((low, high) for low, high in runs)


# ---- protection --------------------------------------------------------------------------------


def _protection(database: Database, message: Message) -> tuple[Profile, bytes, list[str]]:
    """Profile and data ids by the DBC's attributes; NONE where there are none."""
    text = _attribute(database, message, "E2EProfile")
    if text is None:
        return Profile.NONE, b"", []
    profile = _PROFILES.get(str(text).lower())
    if profile is None:
        return Profile.NONE, b"", [f"E2EProfile {text!r}; known: None, P02, P05"]
    if profile is Profile.NONE:
        return profile, b"", []
    problems = []
    if message.length < HEADER_BYTES[profile]:
        problems.append(f"{message.length} bytes have no room for the {profile.name} header")
    own = message.dbc.attributes if message.dbc and message.dbc.attributes else {}
    data_id = own["E2EDataId"].value if "E2EDataId" in own else message.frame_id
    if profile is Profile.P05:
        if not isinstance(data_id, int) or not 0 <= data_id <= 0xFFFF:
            problems.append(f"E2EDataId {data_id} does not fit in 16 bits")
            data_id = 0
        return profile, int(data_id).to_bytes(2, "big"), problems
    listed = _attribute(database, message, "E2EDataIdList") or ""
    if listed and not re.fullmatch(r"[0-9A-Fa-f]{32}", str(listed)):
        problems.append(f"E2EDataIdList {str(listed)!r} is not 32 hex digits")
        listed = ""
    return profile, bytes.fromhex(listed) if listed else p02_data_ids(int(data_id)), problems


def _header(name: str, profile: Profile, signals: Sequence[SignalSpec]) -> Iterator[str]:
    """The header's own signals must lie where the profile has them, and no other there."""
    if profile is Profile.NONE:
        return
    header = {label: (start, length) for label, start, length in _HEADERS[profile]}
    size = sum(length for _, length in header.values())
    for signal in signals:
        if signal.name in header:
            if (signal.start, signal.length, signal.is_big_endian, signal.is_signed) != (
                *header[signal.name], False, False,
            ):  # fmt: skip
                start, length = header[signal.name]
                yield f"{name}.{signal.name}: {profile.name} has it at {start}|{length}@1+"
            continue
        bits = bits_of(signal, signal.is_big_endian)
        low = min(8 * (b >> 3) + 7 - (b & 7) if signal.is_big_endian else b for b in bits)
        if low < size:
            yield f"{name}.{signal.name}: lies in the {profile.name} header"


# ---- comparison --------------------------------------------------------------------------------


def _compare(
    specs: Collection[MessageSpec], nodes: tuple[int, ...], contract: Contract
) -> Iterator[str]:
    by_name = {spec.name: spec for spec in specs}
    for name, need, _ in contract.named(nodes):
        spec = by_name.get(name)
        if spec is None:
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
