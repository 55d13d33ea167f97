"""The figures of a run's report: one with the flags of the whole train, and one of each drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from gateway.reports import figures
from gateway.reports.trace import POINTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from gateway.reports.trace import Trace
    from gateway.reports.truth import Truth

_POINT_STYLE: Final = dict(
    zip(
        POINTS,
        ((figures.ORANGE, "-"), (figures.BLUE, "--"), (figures.GREEN, "-."), (figures.PURPLE, ":")),
        strict=True,
    )
)
_POINT_NAME: Final = dict(
    zip(POINTS, ("stator", "drive end", "non-drive end", "ambient"), strict=True)
)

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
    with figures.styled():
        step("picture of the flags")
        train(folder / "flags.svg", trace, truth)
        for node in trace.nodes:
            step(f"picture of drive {node}")
            drive(folder / f"drive{node}.svg", trace, node, truth, raise_probability)
    return ["flags", *(f"drive{node}" for node in trace.nodes)]


def _spans(truth: Truth | None, node: int, flag: str) -> list[figures.Span]:
    """True intervals of a drive; faults of sensors are shown with the thermal ones."""
    events = [] if truth is None else truth.events
    shown = ("thermal", "sensor") if flag == "thermal" else (flag,)
    return [
        figures.Span(e.start_s, e.end_s, node, e.kind)
        for e in events
        if e.node == node and e.flag in shown
    ]


def train(path: Path, trace: Trace, truth: Truth | None) -> None:
    """Draw adhesion and thermal flags of every drive, and the bus load."""
    nodes, end_s = trace.nodes, trace.span_s
    high = 0.15 + 0.24 * len(nodes)
    load = trace.of_all("bus_load_percent")
    wanted = [figures.Panel(high, ""), figures.Panel(high, "")]
    if load.known:
        wanted.append(figures.Panel(0.8, "bus load\n%"))
    figure, axes = figures.panels(wanted)
    for axis, flag in zip(axes, ("adhesion", "thermal"), strict=False):
        for row, node in enumerate(nodes):
            spans = _spans(truth, node, flag)
            figures.truth_bars(axis, row, spans, 1.0, "#cccccc")
            figures.strip(axis, row, trace.curve(node, flag), end_s)
        figures.strips(axis, [f"{flag} {node}" for node in nodes])
    if load.known:
        figures.line(axes[-1], load, color=figures.BLUE, label="bus load", bridge=True)
        axes[-1].set_ylim(0.0, max(100.0, 1.05 * float(np.nanmax(load.high))))
    figures.foot(figure, figures.key("good", "bad", truth=truth is not None and bool(truth.events)))
    axes[0].set_xlim(0.0, max(end_s, 1e-3))
    figures.save(figure, path)


def drive(
    path: Path, trace: Trace, node: int, truth: Truth | None, raise_probability: float
) -> None:
    """Draw load, loss probability, flags, speed and temperatures of one drive."""
    end_s = trace.span_s
    true_loss, true_fault = _spans(truth, node, "adhesion"), _spans(truth, node, "thermal")
    rows = ["adhesion", "thermal"]
    rows += [
        name for name, spans in (("true loss", true_loss), ("true fault", true_fault)) if spans
    ]
    points = {name: trace.curve(node, name) for name in POINTS}
    mixed, maisd = trace.curve(node, "mixed_c"), trace.curve(node, "maisd_k")
    warm = mixed.known or any(curve.known for curve in points.values())
    true = truth is not None and node in truth.nodes
    loaded = true or trace.curve(node, "load_nm").known
    moved = true or trace.curve(node, "speed_rad_s").known
    wanted = [
        figures.Panel(1.6 if loaded else EMPTY, "load / Nm", names=loaded),
        figures.Panel(0.7 if trace.curve(node, "loss_probability").known else EMPTY, "P(lost)\n%"),
        figures.Panel(0.12 + 0.24 * len(rows), ""),
        figures.Panel(0.95 if moved else EMPTY, "speed\nrad/s", names=moved),
    ]  # fmt: skip
    wanted += [figures.Panel(1.25, "temperature\ndegC", names=True)] if warm else []
    wanted += [figures.Panel(0.7, "MAISD\nK")] if maisd.known else []
    figure, axes = figures.panels(wanted)
    shown = iter(axes)
    figures.load_panel(next(shown), trace, node, truth)
    _probability(next(shown), trace, node, raise_probability)
    flags = next(shown)
    for row, name in enumerate(rows[:2]):
        figures.strip(flags, row, trace.curve(node, name), end_s)
    for row, name in enumerate(rows[2:], 2):
        figures.truth_bars(flags, row, true_loss if name == "true loss" else true_fault)
    figures.strips(flags, rows)
    _speed(next(shown), trace, node, truth)
    if warm:
        axis = next(shown)
        for name, curve in points.items():
            if curve.known:
                color, dashes = _POINT_STYLE[name]
                figures.line(
                    axis, curve, color=color, ls=dashes, label=_POINT_NAME[name], bridge=True
                )
        if mixed.known:
            figures.line(axis, mixed, color="black", label="mixed state", bridge=True, lw=1.3)
        figures.legend(axis, 5)
    if maisd.known:
        axis = next(shown)
        figures.line(axis, maisd, color=figures.YELLOW, label="MAISD", bridge=True)
        axis.set_ylim(0.0, max(LEAST_K, 1.05 * float(np.nanmax(maisd.high))))
    figures.foot(figure, figures.key(truth=bool(rows[2:])))
    axes[0].set_xlim(0.0, max(end_s, 1e-3))
    figures.save(figure, path)


def _probability(axis: Axes, trace: Trace, node: int, raise_probability: float) -> None:
    curve = trace.curve(node, "loss_probability")
    if not curve.known:
        figures.nothing(axis, "no probability of a loss was ever known")
        return
    percent = curve._replace(low=100.0 * curve.low, high=100.0 * curve.high)
    figures.line(axis, percent, color=figures.ORANGE, label="P(lost)")
    axis.axhline(100.0 * raise_probability, color="#444444", lw=0.8, ls=":")
    axis.set_ylim(-4.0, 104.0)
    axis.set_yticks([0, 50, 100])


def _speed(axis: Axes, trace: Trace, node: int, truth: Truth | None) -> None:
    estimate = trace.curve(node, "speed_rad_s")
    true = None if truth is None else truth.speed(node)
    if true is None and not estimate.known:
        figures.nothing(axis, "the speed was never known")
        return
    if estimate.known:
        figures.line(axis, estimate, color=figures.BLUE, label="estimated")
    if true is not None:
        figures.true_line(axis, true)
    figures.legend(axis)
    figures.at_least(axis, LEAST_RAD_S)
