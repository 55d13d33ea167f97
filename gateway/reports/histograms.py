"""Histograms of a run's timing as SVG text, below one another on one logarithmic axis of time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from gateway.io.timing import Stage
from gateway.reports.figures import BLUE, DARK, ORANGE
from gateway.reports.svg import X0, X1, label, rule, write_drawing

_HIGH, _GAP, _FOOT = 64.0, 30.0, 30.0
"""Points: height of a histogram, space above it, and below all of them."""
_SHOWN_NS: Final = 1024
"""All shorter times share one bar."""


class _Axis(NamedTuple):
    """Times from low to high, ns."""

    low: float
    high: float

    def x(self, ns: float) -> float:
        share = math.log(max(ns, self.low) / self.low) / math.log(self.high / self.low)
        return X0 + (X1 - X0) * share


def write_histograms(path: Path, stages: Sequence[Stage], period_ns: int) -> None:
    """Write a histogram of each stage, with a bar for each octave. Raises OSError."""
    most = max([below for stage in stages for _, below, _ in stage.octaves] + [period_ns])
    axis = _Axis(_SHOWN_NS / 2, 1.5 * most)
    parts: list[str] = []
    base = 0.0
    for stage in stages:
        base += _GAP + _HIGH
        parts += _histogram(stage, base, axis, period_ns)
    for ns in _decades(axis):
        parts.append(label(axis.x(ns), base + 12, f"{ns / 1e6:g}", "middle"))
    words = "time / ms; height of a bar: logarithm of its number of ticks"
    parts.append(label(0.5 * (X0 + X1), base + 25, words, "middle"))
    write_drawing(path, parts, base + _FOOT)


def _histogram(stage: Stage, base: float, axis: _Axis, period_ns: int) -> Iterator[str]:
    """The parts of a histogram above `base`."""
    top = base - _HIGH
    for ns in _decades(axis):
        yield rule("grid", axis.x(ns), top, axis.x(ns), base)
    counts: Counter[int] = Counter()
    for _, below, count in stage.octaves:
        counts[max(below, _SHOWN_NS)] += count
    scale = _HIGH / math.log1p(max(counts.values(), default=1))
    for below, count in counts.items():
        left, right, high = axis.x(below / 2), axis.x(below), scale * math.log1p(count)
        size = f'width="{right - left:.2f}" height="{high:.2f}"'
        yield f'<rect fill="{BLUE}" stroke="white" x="{left:.2f}" y="{base - high:.2f}" {size}/>'
    words = f"{stage.name}: {stage.values} ticks, period {period_ns / 1e6:g} ms (dashed)"
    yield _mark(axis.x(period_ns), top, base, f'stroke="{DARK}" stroke-dasharray="4 2"')
    if stage.values:
        words += f", p99 {stage.p99 / 1e6:.3f} ms (line)"
        yield _mark(axis.x(stage.p99), top, base, f'stroke="{ORANGE}" stroke-width="1.4"')
    yield label(X0, top - 5, words, "name")
    yield rule("axis", X0, base, X1, base)


def _mark(x: float, top: float, base: float, look: str) -> str:
    return f'<path d="M{x:.2f} {top:.2f}V{base:.2f}" {look}/>'


def _decades(axis: _Axis) -> list[float]:
    """Powers of ten on the axis, ns."""
    return [10.0**k for k in range(3, math.floor(math.log10(axis.high)) + 1)]
