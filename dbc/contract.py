"""What the gateway needs of a DBC: messages, signals, units, states. `bind` compares.

Scaling, bit positions, ids and cycle times are free (they come from the DBC); names, units, widths
of states and meanings of codes are those of the message table. That the table is right is for
`tests/unit/test_dbc_files.py` to say, which has it once more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from dbc.messages import GATEWAY, Entry, Field, drive_messages, gateway_messages

SI_FACTOR: Final[Mapping[str, float]] = {
    "": 1.0,
    "A": 1.0,
    "V": 1.0,
    "Nm": 1.0,
    "degC": 1.0,
    "K": 1.0,
    "K/h": 1.0,
    "%": 0.01,
    "ms": 1e-3,
    "us": 1e-6,
    "rpm": 2.0 * math.pi / 60.0,
    "deg": math.pi / 180.0,
}
"""Unit on the wire -> factor to what the core computes with (A, V, Nm, rad/s, rad, 1, s).

Celsius stays Celsius, K/h stays K/h: the thermal side works with differences and rates of these.
"""


class Direction(Enum):
    """Who sends the message, seen from the gateway."""

    CONSUMED = "consumed"
    PRODUCED = "produced"


@dataclass(frozen=True, slots=True)
class SignalNeed:
    """One signal: unit on the wire, and code -> label where codes have a meaning."""

    name: str
    unit: str = ""
    codes: Mapping[int, str] = field(default_factory=dict)
    bits: int = 0
    """Required width; 0 leaves it free."""

    @property
    def si_factor(self) -> float:
        """Factor from the unit on the wire to SI."""
        return SI_FACTOR[self.unit]


@dataclass(frozen=True, slots=True)
class MessageNeed:
    """One kind of message; `per_drive` ones exist as `Drive{n}_<kind>`, others as `Gateway_..`."""

    kind: str
    direction: Direction
    signals: tuple[SignalNeed, ...]
    per_drive: bool = True
    length: int = 8
    fd: bool = False
    cyclic: bool = True
    stale_periods: int = 3
    """Older than this many periods plus a tick is stale."""

    def name(self, node: int) -> str:
        """Name in the DBC; `node` is ignored for the gateway's own."""
        return f"Drive{node}_{self.kind}" if self.per_drive else f"Gateway_{self.kind}"


@dataclass(frozen=True, slots=True)
class Contract:
    """A set of message kinds."""

    messages: tuple[MessageNeed, ...]

    def named(self, nodes: tuple[int, ...]) -> Iterator[tuple[str, MessageNeed, int]]:
        """(name, need, node or 0) of every message the given drives and the gateway need."""
        for need in self.messages:
            if not need.per_drive:
                yield need.name(0), need, 0
            for node in nodes if need.per_drive else ():
                yield need.name(node), need, node

    def si_factor(self, kind: str, signal: str) -> float:
        """SI factor of a signal. Raises KeyError for one that is not in the contract."""
        for need in self.messages:
            for wanted in need.signals if need.kind == kind else ():
                if wanted.name == signal:
                    return wanted.si_factor
        raise KeyError(f"{kind}.{signal}")


def _message(entry: Entry) -> MessageNeed:
    return MessageNeed(
        kind=entry.name.partition("_")[2],
        direction=Direction.PRODUCED if entry.sender == GATEWAY else Direction.CONSUMED,
        signals=tuple(map(_signal, entry.fields)),
        per_drive="{n}" in entry.name,
        length=64 if entry.fd else 8,
        fd=entry.fd,
        cyclic=entry.cycle_ms > 0,
    )


def _signal(f: Field) -> SignalNeed:
    """States, indices and codes have their width; measured values and `Quality` any."""
    codes = {raw: label for raw, label in f.labels.items() if raw <= f.high}
    measured = f.code is not None and not codes
    return SignalNeed(f.name, f.unit, codes, 0 if measured or f.name == "Quality" else f.length)


def _contract(fd: bool) -> Contract:
    return Contract(tuple(map(_message, (*drive_messages(fd), *gateway_messages()))))


CLASSIC: Final = _contract(fd=False)
"""The set of `traction.dbc`."""
FD: Final = _contract(fd=True)
"""The set of `traction_fd.dbc`: `Samples` replaces currents and voltages."""
ANY: Final = Contract(())
"""No expectations: any DBC that is sound in itself."""
