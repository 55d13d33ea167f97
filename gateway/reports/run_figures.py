"""The figures of a run's report: one with the flags of the whole train, and one of each drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from gateway.core.codes import Flag
from gateway.reports.figures import BLUE, GREEN, ORANGE, PURPLE, SKY, YELLOW, Span
from gateway.reports.svg import Bar, Line, Panel, write_panels
from gateway.reports.trace import POINTS, RANK, Curve

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from gateway.reports.trace import Trace
    from gateway.reports.truth import Truth

_POINTS: Final = dict(zip(POINTS, (
    ("stator", ORANGE, ""), ("drive end", BLUE, "4 2"), ("non-drive end", GREEN, "5 2 1 2"),
    ("ambient", PURPLE, "1 2"),
), strict=True))  # fmt: skip
"""Name, colour and dashes of each temperature sensor."""
_KIND: Final = {RANK[flag]: flag.name.lower() for flag in (Flag.GOOD, Flag.UNKNOWN, Flag.BAD)}
EMPTY: Final = 0.42
"""Height in inches of a panel without values."""
LEAST_RAD_S: Final = 2.0
LEAST_K: Final = 0.5
"""Least spans of the axes of speed and MAISD: else noise fills a panel and looks like an event."""


def draw(
    folder: Path,
    trace: Trace,
    truth: Truth | None,
    raise_probability: float,
    step: Callable[[str], None],
) -> list[str]:
    """Write the figures as SVG; return their names without suffix: `flags`, then `drive<node>`.

    step: called with the name of each figure before it is drawn, N + 1 times.
    """
    step("picture of the flags")
    train(folder / "flags.svg", trace, truth)
    for node in trace.nodes:
        step(f"picture of drive {node}")
        drive(folder / f"drive{node}.svg", trace, node, truth, raise_probability)
    return ["flags", *(f"drive{node}" for node in trace.nodes)]


def _spans(truth: Truth | None, node: int, flag: str) -> list[Span]:
    """True intervals of a drive; faults of sensors are shown with the thermal ones."""
    events = [] if truth is None else truth.events
    shown = ("thermal", "sensor") if flag == "thermal" else (flag,)
    return [
        Span(e.start_s, e.end_s, node, e.kind) for e in events if e.node == node and e.flag in shown
    ]


def _bars(row: int, curve: Curve, end_s: float) -> Iterator[Bar]:
    """One flag; `curve` holds ranks of `trace.RANK`, of merged ticks the worst."""
    rank = curve.high
    if not len(rank):
        return
    begins = np.flatnonzero(np.concatenate(([True], np.diff(rank) != 0)))
    ends = [*curve.t_s[begins[1:]].tolist(), end_s]
    for begin, end in zip(begins.tolist(), ends, strict=True):
        yield Bar(row, float(curve.t_s[begin]), end, _KIND[float(rank[begin])])


def _truth_bars(row: int, spans: list[Span], kind: str = "true") -> Iterator[Bar]:
    for span in spans:
        yield Bar(row, span.start_s, span.end_s, kind)


def train(path: Path, trace: Trace, truth: Truth | None) -> None:
    """Draw adhesion and thermal flags of every drive, and the bus load."""
    panels = []
    for flag in ("adhesion", "thermal"):
        panel = Panel(0.15 + 0.24 * len(trace.nodes), rows=[f"{flag} {n}" for n in trace.nodes])
        for row, node in enumerate(trace.nodes):
            panel.bars += _truth_bars(row, _spans(truth, node, flag), "behind")
            panel.bars += _bars(row, trace.curve(node, flag), trace.span_s)
        panels.append(panel)
    load = trace.of_all("bus_load_percent")
    if load.known:
        most = max(100.0, 1.05 * float(np.nanmax(load.high)))
        lines = [Line(load, BLUE, "bus load", bridge=True)]
        panels.append(Panel(0.8, "bus load\n%", limits=(0.0, most), lines=lines))
    write_panels(path, panels, trace.span_s, true=truth is not None and bool(truth.events))


def drive(
    path: Path, trace: Trace, node: int, truth: Truth | None, raise_probability: float
) -> None:
    """Draw load, loss probability, flags, speed and temperatures of one drive."""
    true_loss, true_fault = _spans(truth, node, "adhesion"), _spans(truth, node, "thermal")
    extra = [("true loss", true_loss), ("true fault", true_fault)]
    extra = [(name, spans) for name, spans in extra if spans]
    rows = ["adhesion", "thermal", *(name for name, _ in extra)]
    flags = Panel(0.12 + 0.24 * len(rows), rows=rows)
    for row, name in enumerate(rows[:2]):
        flags.bars += _bars(row, trace.curve(node, name), trace.span_s)
    for row, (_, spans) in enumerate(extra, 2):
        flags.bars += _truth_bars(row, spans)
    panels = [
        _load(trace, node, truth), _probability(trace, node, raise_probability), flags,
        _speed(trace, node, truth), *_temperatures(trace, node),
    ]  # fmt: skip
    write_panels(path, panels, trace.span_s, true=bool(extra))


def _true_line(curve: Curve) -> Line:
    """A true value, on top of its estimate."""
    return Line(curve, "black", "true", "4 2", 0.9)


def _load(trace: Trace, node: int, truth: Truth | None) -> Panel:
    """The load torque: the estimate with its band, and the true value if it is known."""
    estimate = trace.curve(node, "load_nm")
    true = None if truth is None else truth.load(node)
    lines = []
    if estimate.known:
        low, high = trace.curve(node, "low_nm").low, trace.curve(node, "high_nm").high
        band = Curve(estimate.t_s, low, high)
        lines = [Line(band, SKY, "its 2 sigma band", band=True), Line(estimate, BLUE, "estimated")]
    lines += [] if true is None else [_true_line(true)]
    if not lines:
        return Panel(EMPTY, "load / Nm", note="the load was never known")
    return Panel(1.6, "load / Nm", named=True, lines=lines)


def _probability(trace: Trace, node: int, raise_probability: float) -> Panel:
    curve, label = trace.curve(node, "loss_probability"), "P(lost)\n%"
    if not curve.known:
        return Panel(EMPTY, label, note="no probability of a loss was ever known")
    percent = curve._replace(low=100.0 * curve.low, high=100.0 * curve.high)
    lines = [Line(percent, ORANGE, "P(lost)")]
    return Panel(0.7, label, limits=(-4.0, 104.0), level=100.0 * raise_probability, lines=lines)


def _speed(trace: Trace, node: int, truth: Truth | None) -> Panel:
    estimate, label = trace.curve(node, "speed_rad_s"), "speed\nrad/s"
    true = None if truth is None else truth.speed(node)
    lines = [Line(estimate, BLUE, "estimated")] if estimate.known else []
    lines += [] if true is None else [_true_line(true)]
    if not lines:
        return Panel(EMPTY, label, note="the speed was never known")
    return Panel(0.95, label, least=LEAST_RAD_S, named=True, lines=lines)


def _temperatures(trace: Trace, node: int) -> Iterator[Panel]:
    """The temperatures and MAISD, where known."""
    points = [(trace.curve(node, name), look) for name, look in _POINTS.items()]
    lines = [
        Line(curve, color, name, dash, bridge=True)
        for curve, (name, color, dash) in points
        if curve.known
    ]
    mixed, maisd = trace.curve(node, "mixed_c"), trace.curve(node, "maisd_k")
    if mixed.known:
        lines.append(Line(mixed, "black", "mixed state", width=1.3, bridge=True))
    if lines:
        yield Panel(1.25, "temperature\ndegC", named=True, lines=lines)
    if maisd.known:
        most = max(LEAST_K, 1.05 * float(np.nanmax(maisd.high)))
        lines = [Line(maisd, YELLOW, "MAISD", bridge=True)]
        yield Panel(0.7, "MAISD\nK", limits=(0.0, most), lines=lines)
