"""Losses injected, found and missed; delays from the truth's onset to the first flag."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol


class TruthRow(Protocol):
    """The part of the simulator's truth that is needed here."""

    @property
    def t_s(self) -> float:
        """Seconds from the start."""
        ...

    @property
    def drive(self) -> int:
        """Node number."""
        ...

    @property
    def lost(self) -> int:
        """1 while adhesion is lost."""
        ...


class Loss(NamedTuple):
    """One stretch of lost adhesion."""

    drive: int
    start_s: float
    end_s: float


class Found(NamedTuple):
    """A loss and when its flag came; None if it never did."""

    loss: Loss
    delay_ms: float | None


def injected(rows: Iterable[TruthRow]) -> list[Loss]:
    """Stretches of `lost` per drive, in order of onset."""
    begun: dict[int, float] = {}
    last: dict[int, float] = {}
    losses = []
    for row in rows:
        last[row.drive] = row.t_s
        if row.lost and row.drive not in begun:
            begun[row.drive] = row.t_s
        elif not row.lost and row.drive in begun:
            losses.append(Loss(row.drive, begun.pop(row.drive), row.t_s))
    losses += [Loss(drive, start, last[drive]) for drive, start in begun.items()]
    return sorted(losses, key=lambda loss: loss.start_s)


def score(
    losses: Sequence[Loss], changes: Sequence[tuple[int, int, str, str]], start_ns: int
) -> list[Found]:
    """Match each loss with the first `AdhesionLost` that begins, or already holds, in it."""
    found = []
    for loss in losses:
        delay = None
        held = False
        for t_ns, node, what, word in changes:
            if node != loss.drive or what != "adhesion":
                continue
            t_s = (t_ns - start_ns) / 1e9
            if t_s < loss.start_s:
                held = word == "AdhesionLost"
                continue
            if held:
                delay = 0.0
                break
            if word == "AdhesionLost":
                delay = (t_s - loss.start_s) * 1e3 if t_s <= loss.end_s else None
                break
        if held and delay is None:
            delay = 0.0
        found.append(Found(loss, delay))
    return found


def summary_table(found: Sequence[Found], nodes: Sequence[int]) -> str:
    """Per drive: losses injected, found, delay."""
    lines = ["drive  losses  found  median delay / ms  worst / ms"]
    for node in nodes:
        mine = [f for f in found if f.loss.drive == node]
        delays = sorted(f.delay_ms for f in mine if f.delay_ms is not None)
        middle = f"{delays[len(delays) // 2]:.0f}" if delays else "-"
        worst = f"{delays[-1]:.0f}" if delays else "-"
        lines.append(f"{node:5}  {len(mine):6}  {len(delays):5}  {middle:>17}  {worst:>10}")
    return "\n".join(lines)
