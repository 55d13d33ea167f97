"""Where signals lie in a message, and what of it cannot be: overlaps, misfits, duplicates."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

from dbc.spec import SignalSpec

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message, Signal


def bits_of(signal: Signal | SignalSpec, big_endian: bool) -> range:
    """Positions in transmission order: byte * 8 + bit, counted along the signal's own order."""
    if not big_endian:
        return range(signal.start, signal.start + signal.length)
    first = 8 * (signal.start >> 3) + 7 - (signal.start & 7)
    return range(first, first + signal.length)


def _occupied(signal: Signal) -> frozenset[int]:
    """Bit numbers as in a DBC grid (bit 0 is the least significant of byte 0)."""
    if signal.byte_order == "big_endian":
        return frozenset(8 * (b >> 3) + 7 - (b & 7) for b in bits_of(signal, True))
    return frozenset(bits_of(signal, False))


def layout_faults(database: Database) -> Iterator[str]:
    """Signals that do not fit, and pairs that overlap without being multiplexed apart."""
    for message in database.messages:
        if message.length > 64:
            yield f"{message.name}: {message.length} bytes; a CAN FD frame has 64"
        bits = {signal.name: _occupied(signal) for signal in message.signals}
        for signal in message.signals:
            if max(bits[signal.name]) >= 8 * message.length:
                yield f"{message.name}.{signal.name}: does not fit in {message.length} bytes"
        for one, other in combinations(message.signals, 2):
            # One name twice is for `duplicates`, and to be told apart only by where it lies.
            if one.name == other.name or not bits[one.name] & bits[other.name]:
                continue
            if not _exclusive(message, one, other):
                yield f"{message.name}: {one.name} and {other.name} overlap"


def _exclusive(message: Message, one: Signal, other: Signal) -> bool:
    """True if no frame can hold both: they need different values of one selector."""
    first, second = _conditions(message, one), _conditions(message, other)
    return any(
        not first[name] & second[name] for name in first.keys() & second.keys()
    )  # fmt: skip


def _conditions(message: Message, signal: Signal) -> dict[str, frozenset[int]]:
    found: dict[str, frozenset[int]] = {}
    by_name = {s.name: s for s in message.signals}
    at: Signal | None = signal
    while at is not None and at.multiplexer_signal and at.multiplexer_signal not in found:
        found[at.multiplexer_signal] = frozenset(at.multiplexer_ids or ())
        at = by_name.get(at.multiplexer_signal)
    return found


def duplicates(messages: Sequence[Message]) -> Iterator[str]:
    """Names and ids used twice, and signals twice in a message: cantools takes the last."""
    names = Counter(m.name for m in messages)
    yield from (f"{name}: defined {k} times" for name, k in names.items() if k > 1)
    ids = defaultdict(list)
    for message in messages:
        ids[(message.frame_id, message.is_extended_frame)].append(message.name)
    for (can_id, extended), users in ids.items():
        if len(users) > 1:
            digits = f"0x{can_id:08X}" if extended else f"0x{can_id:03X}"
            yield f"id {digits}: shared by {', '.join(users)}"
    for message in messages:
        signals = Counter(s.name for s in message.signals)
        yield from (f"{message.name}.{s}: defined {k} times" for s, k in signals.items() if k > 1)
