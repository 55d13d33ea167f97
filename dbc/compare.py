"""Compare a DBC with the contract: objections, one line each."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from dbc.contract import Contract, MessageNeed, SignalNeed
from dbc.spec import MessageSpec, SignalSpec


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
