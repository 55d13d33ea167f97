"""Positions of signals in a message, and their faults: overlaps, misfits, duplicates."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Final

from dbc.spec import SignalSpec

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message, Signal


_BO: Final = re.compile(rb"\s*BO_\s+\d+\s+(\w+)\s*:\s*(\d+)")
_SG: Final = re.compile(rb"\s*SG_\s+(\w+)[^:]*:\s*(\d+)\s*\|\s*(\d+)\s*@")
_MUX: Final = re.compile(rb"\s*SG_MUL_VAL_\s")
_TO: Final = re.compile(rb"\d\s*-\s*(\d+)")
_QUOTED: Final = re.compile(rb'"[^"]*"')
_HUGE: Final = re.compile(rb"\d[eE]\+?0*(?:[3-9]\d\d|[1-9]\d{3,})|\d{300}")
_INDEPENDENT: Final = b"VECTOR__INDEPENDENT_SIG_MSG"


def oversized(text: bytes) -> Iterator[str]:
    """Yield lines with numbers impossible in CAN, for which cantools would allocate memory."""
    for number, line in enumerate(text.split(b"\n"), 1):
        where = f"line {number}"
        if match := _BO.match(line):
            if int(match[2]) > 64 and match[1] != _INDEPENDENT:
                yield f"{where}: {match[1].decode()}: {int(match[2])} bytes; CAN FD has 64"
        elif match := _SG.match(line):
            name = f"{where}: {match[1].decode()}"
            if not 1 <= int(match[3]) <= 64:
                yield f"{name}: {int(match[3])} bits; 1 to 64 are possible"
            elif int(match[2]) > 511:
                yield f"{name}: starts at bit {int(match[2])} of 512"
        elif _MUX.match(line) and any(int(value) > 0xFFFF for value in _TO.findall(line)):
            yield f"{where}: multiplexer values above 65535"
        if _HUGE.search(_QUOTED.sub(b"", line)):
            yield f"{where}: a number with more than 300 digits"


def bits_of(signal: Signal | SignalSpec, big_endian: bool) -> range:
    """Positions of a signal's bits, byte * 8 + bit; bits count in the signal's own byte order."""
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
    """Yield signals that do not fit, and overlapping pairs that one frame can hold together."""
    for message in database.messages:
        bits = {signal.name: _occupied(signal) for signal in message.signals}
        for signal in message.signals:
            if max(bits[signal.name]) >= 8 * message.length:
                yield f"{message.name}.{signal.name}: does not fit in {message.length} bytes"
        for one, other in combinations(message.signals, 2):
            # `duplicates` reports two signals of one name; here only their positions differ.
            if one.name == other.name or not bits[one.name] & bits[other.name]:
                continue
            if not _exclusive(message, one, other):
                yield f"{message.name}: {one.name} and {other.name} overlap"


def _exclusive(message: Message, one: Signal, other: Signal) -> bool:
    """True if no frame can hold both signals: they need different values of one selector."""
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
    """Yield names and ids used twice, and signals twice in a message; cantools keeps the last."""
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
