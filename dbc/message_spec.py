"""One message of a DBC as a spec: layout, scaling, ranges, codes, and their faults."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from dbc import contract as expected
from dbc.contract import Direction
from dbc.protection import attribute, header_faults, protection
from dbc.spec import MessageSpec, SignalSpec

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message, Signal

_NAME: Final = re.compile(r"(?:Drive(\d{1,2})|Gateway)_(\w+)")
_NO_DATA_LABELS: Final = frozenset({"notavailable", "notavail", "na", "sna"})
_PRODUCED: Final = frozenset(
    (need.kind, need.per_drive)
    for need in expected.CLASSIC.messages
    if need.direction is Direction.PRODUCED
)
_CLASSIC_BYTES: Final = 8
_FD_BYTES: Final = 64
_LONGEST_CYCLE_MS: Final = 3_600_000
# A bound divided by the scale is off by a few ulp; raw bounds are whole numbers.
_SLACK: Final = 1e-6


def is_long(message: Message) -> bool:
    """Whether only a CAN FD frame can carry a message: J1939 sends long ones in several frames."""
    return message.protocol != "j1939" and _CLASSIC_BYTES < message.length <= _FD_BYTES


def message_spec(
    database: Database, message: Message, index: int, *, long: bool = False
) -> tuple[MessageSpec, list[str], dict[str, str]]:
    """The message; its faults; the signals that cannot be decoded, each with the reason.

    long: other messages of the DBC have more than 8 bytes, so that the bus is CAN FD.
    The spec holds no faulty value: an impossible range is left out, such a cycle time is 0.
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
    profile, ids, faults = protection(database, message)
    problems += (f"{message.name}: {fault}" for fault in faults)
    problems += header_faults(message.name, profile, signals)
    problems += _selectors(message.name, signals)
    match = _NAME.fullmatch(message.name)
    node = int(match[1] or 0) if match else 0
    kind = match[2] if match else message.name
    brs = attribute(database, message, "CANFD_BRS")
    is_unsaid = attribute(database, message, "VFrameFormat") is None
    is_fd = message.is_fd or (is_unsaid and is_long(message))
    cycle = message.cycle_time or 0
    if not isinstance(cycle, (int, float)) or not 0 <= cycle <= _LONGEST_CYCLE_MS:
        problems.append(f"{message.name}: GenMsgCycleTime {cycle!r} is not a time in ms")
        cycle = 0
    return (
        MessageSpec(
            name=message.name,
            can_id=message.frame_id,
            length=message.length,
            is_fd=is_fd,
            # If the attribute is not there, Vector's default is with bit rate switch.
            brs=is_fd and str(1 if brs is None else brs) == "1",
            cycle_ns=round(cycle * 1_000_000),
            profile=profile,
            data_ids=ids,
            signals=tuple(signals),
            index=index,
            node=node,
            kind=kind,
            is_extended=message.is_extended_frame,
            is_gateway=match is not None and (kind, node > 0) in _PRODUCED,
            is_either=is_unsaid and long and not is_fd,
        ),
        problems,
        unusable,
    )


def chain_end(name: str, parents: Mapping[str, str | None]) -> str | None:
    """Selector at which a signal's chain breaks: one that is missing or comes twice; else None.

    parents: of each signal, the selector that multiplexes it, or None.
    """
    at, seen = parents[name], {name}
    while at is not None and at in parents and at not in seen:
        seen.add(at)
        at = parents[at]
    return at


def _selectors(name: str, signals: Sequence[SignalSpec]) -> Iterator[str]:
    """Yield signals whose chain of selectors leaves the message or ends in a loop."""
    parents = {signal.name: signal.mux_parent for signal in signals}
    for signal in signals:
        at = chain_end(signal.name, parents)
        if at in parents:
            yield f"{name}.{signal.name}: is multiplexed by itself"
        elif at is not None:
            yield f"{name}.{signal.name}: is multiplexed by {at}, which the message does not have"


def _signal_spec(signal: Signal) -> tuple[SignalSpec, list[str], str]:
    """The signal; its faults, which are left out; why it cannot be decoded, or ""."""
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
        # Some tools write a code of a signed signal as the unsigned value of its bits.
        wrapped = (
            int(raw) - (1 << signal.length) if signal.is_signed and int(raw) > high else int(raw)
        )
        labels[wrapped] = str(label)
    raw_min, raw_max = low, high
    float_min, float_max = SignalSpec.float_limits()
    bounds = (signal.minimum, signal.maximum)
    # Many tools write two equal bounds if there is no range.
    if bounds[0] is not None and bounds[1] is not None and bounds[0] != bounds[1]:
        minimum, maximum = float(bounds[0]), float(bounds[1])
        if minimum > maximum:
            problems.append(f"range {minimum:g}..{maximum:g} is empty")
        elif signal.is_float:
            float_min, float_max = max(minimum, float_min), min(maximum, float_max)
        else:
            ends = sorted(((minimum - offset) / scale, (maximum - offset) / scale))
            # Bounds beyond those of the type, infinite ones too, are clamped to them.
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
    """Raw start value and its faults; 0 if it is not given, faulty, or that of a float."""
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
    """The not-available code, if a label such as NotAvailable marks one, else None.

    At an end of the raw limits, or with all bits set, such a label marks the code. Elsewhere it
    does so only if no other label names a state, or outside the range; there "NA", which may be a
    country, does not count. Of several the highest is the code: `Reason` has a cause called
    NotAvailable below its own code.
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
    """Whether a label names no state, but no data, an error, or data not yet valid."""
    return (
        _says_no_data(label)
        or re.search(r"err|fault|invalid|init|unknown|reserved", label, re.I) is not None
    )


def _runs(values: Collection[int]) -> tuple[tuple[int, int], ...]:
    """The numbers as sorted inclusive runs (first, last)."""
    runs: list[list[int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][1] + 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    return tuple((low, high) for low, high in runs)
