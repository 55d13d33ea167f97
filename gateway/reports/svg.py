"""Panels of a run's report as SVG text: curves, bands and strips of flags over one time axis.

Written without matplotlib, whose import alone takes half as long as the replay of two minutes.
The colours are those of `figures`; line style, height or hatch always shows the same as a colour.
The same run gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from gateway.io.whole_file import write_text
from gateway.reports.figures import LEFT, RIGHT, WIDTH_IN, broken
from gateway.reports.trace import Curve

INCH: Final = 72.0
_WIDTH: Final = WIDTH_IN * INCH
X0, X1 = LEFT * _WIDTH, RIGHT * _WIDTH
_TOP, _GAP, _NAMES, _FOOT = 9.0, 10.0, 13.0, 54.0
_CHARACTER: Final = 4.9
"""Usual width of a character of a legend, points."""
_MOST: Final = 1e30
"""Values beyond are drawn there: the sum of two may overflow."""
_STYLE: Final = """text{font:9px "DejaVu Sans",Verdana,sans-serif;fill:#444444}
.name{font-size:8px}.middle{text-anchor:middle}.end{text-anchor:end}
.grid{stroke:#dddddd;stroke-width:.5}.axis{stroke:#444444;stroke-width:.6}
path{fill:none;stroke-linejoin:round}
.good{fill:#009E73}.bad{fill:#D55E00;stroke:black;stroke-width:.5}
.unknown{fill:url(#hatch);stroke:#999999;stroke-width:.4}
.true{fill:#bbbbbb;stroke:black;stroke-width:.5}.behind{fill:#cccccc;stroke:black;stroke-width:.5}
"""
_HATCH: Final = (
    '<pattern id="hatch" width="4" height="4" patternUnits="userSpaceOnUse"><path d="M-1 1L1 -1M0 '
    '4L4 0M3 5L5 3" stroke="#999999" stroke-width=".6"/></pattern>'
)
HEIGHTS: Final = {"good": 0.28, "unknown": 0.6, "bad": 0.86, "true": 0.6, "behind": 1.0}
"""Kinds of bars, and their heights as shares of a row."""
KEY: Final = {"good": "good (thin)", "bad": "bad (tall)", "unknown": "Unknown (hatched)"}


class Line(NamedTuple):
    """A curve; of merged ticks also the band from their smallest to largest value.

    bridge: connect across unknown values, for values that come less often than ticks. band: draw
    only the area between low and high.
    """

    curve: Curve
    color: str
    name: str
    dash: str = ""
    width: float = 1.1
    bridge: bool = False
    band: bool = False


class Bar(NamedTuple):
    """An interval in a row of a panel; kind: one of `HEIGHTS`."""

    row: int
    begin_s: float
    end_s: float
    kind: str


@dataclass
class Panel:
    """One pair of axes. height: inches.

    rows: names of the rows of bars, which have no vertical axis. limits: of the vertical axis;
    None: those of the values, at least `least` apart. level: of a dotted line. note: text of a
    panel without values. named: a legend above.
    """

    height: float
    label: str = ""
    rows: Sequence[str] = ()
    limits: tuple[float, float] | None = None
    least: float = 0.0
    level: float | None = None
    note: str = ""
    named: bool = False
    lines: list[Line] = field(default_factory=list)
    bars: list[Bar] = field(default_factory=list)


def write_panels(path: Path, panels: Sequence[Panel], end_s: float, *, true: bool) -> None:
    """Write the panels below one another, on a time axis from 0 to `end_s`. true: key of truth."""
    end_s = max(end_s, 1e-3)
    key = KEY | ({"true": "true"} if true else {})
    parts: list[str] = []
    top = _TOP
    for panel in panels:
        top += _NAMES * panel.named
        parts += _panel(panel, top, end_s)
        top += INCH * panel.height + _GAP
    bottom = top - _GAP
    parts += [label(_x(t, end_s), bottom + 12, _number(t, step), "middle")
              for t, step in _ticks(0.0, end_s, 9)]  # fmt: skip
    parts.append(label(0.5 * (X0 + X1), bottom + 25, "time / s", "middle"))
    x = X0
    for kind, words in key.items():
        parts.append(
            f'<rect class="{kind}" x="{x:.1f}" y="{bottom + 36:.1f}" width="15" height="6"/>'
        )
        parts.append(label(x + 19, bottom + 42, words, "name"))
        x += 19 + _CHARACTER * len(words) + 14
    write_drawing(path, parts, bottom + _FOOT)


def write_drawing(path: Path, parts: Sequence[str], height: float) -> None:
    """Write the parts as a file of this height in points. Raises OSError."""
    size = f"{_WIDTH:g} {height:g}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}">\n<style>{_STYLE}</style>'
    write_text(path, "\n".join([head, f"<defs>{_HATCH}</defs>", *parts, "</svg>", ""]))


def _panel(panel: Panel, top: float, end_s: float) -> Iterator[str]:
    """The parts of a panel below `top`."""
    high = INCH * panel.height
    base = top + high
    for t, _ in _ticks(0.0, end_s, 9):
        yield rule("grid", _x(t, end_s), top, _x(t, end_s), base)
    if panel.rows:
        step = high / (len(panel.rows) + 0.1)
        for row, name in enumerate(panel.rows):
            yield label(X0 - 5, top + step * (row + 0.55) + 3, name, "end")
        for bar in panel.bars:
            yield _bar(bar, top, step, end_s)
    elif panel.lines:
        low, most = panel.limits or _limits(panel)
        scale = high / (most - low)

        def place(values: Array) -> Array:
            return base - (np.clip(values, -_MOST, _MOST) - low) * scale

        for value, step in _ticks(low, most, max(2, round(high / 18))):
            y = base - (value - low) * scale
            yield rule("grid", X0, y, X1, y)
            yield label(X0 - 5, y + 3, _number(value, step), "end")
        for line in panel.lines:
            yield from _curve(line, place, end_s)
        if panel.level is not None:
            y = base - (panel.level - low) * scale
            yield f'<path d="M{X0:g} {y:.2f}H{X1:g}" stroke="#444444" stroke-dasharray="1 2"/>'
        yield rule("axis", X0, top, X0, base)
    if panel.note:
        yield label(0.5 * (X0 + X1), top + 0.5 * high + 3, panel.note, "middle")
    yield rule("axis", X0, base, X1, base)
    words = panel.label.split("\n") if panel.label else []
    for k, word in enumerate(words):
        x, y = 20 + 11 * (k - 0.5 * (len(words) - 1)), top + 0.5 * high
        turned = f' transform="rotate(-90 {x:.1f} {y:.1f})"'
        yield label(x, y, word, "middle", turned)
    yield from _names(panel, top) if panel.named else ()


def _names(panel: Panel, top: float) -> Iterator[str]:
    """The legend above a panel, in one line, so that it hides nothing."""
    x, y = X0 + 2, top - 5
    for line in panel.lines:
        wide = 6.0 if line.band else line.width
        look = _look(line, wide) + (' stroke-opacity=".35"' if line.band else "")
        yield f'<path d="M{x:.1f} {y:.1f}h15"{look}/>'
        yield label(x + 19, y + 3, line.name, "name")
        x += 19 + _CHARACTER * len(line.name) + 12


def _curve(line: Line, place: Callable[[Array], Array], end_s: float) -> Iterator[str]:
    """A curve as a path, and its band."""
    t_s, low, high = line.curve
    if line.bridge:
        known = np.isfinite(low)
        t_s, low, high = t_s[known], low[known], high[known]
    t_s, low, high = broken(t_s, low, high)
    x, merged = _x(t_s, end_s), not np.array_equal(low, high, equal_nan=True)
    below, above = place(low), place(high)
    if merged or line.band:
        opacity = 0.35 if line.band else 0.45
        shape = "".join(_areas(x, below, above))
        yield f'<path d="{shape}" style="fill:{line.color};fill-opacity:{opacity}"/>'
    if not line.band:
        shape = "".join(_pieces(x, 0.5 * (below + above)))
        yield f'<path d="{shape}"{_look(line, 0.9 if merged else line.width)}/>'


def _look(line: Line, width: float) -> str:
    dashes = f' stroke-dasharray="{line.dash}"' if line.dash else ""
    return f' stroke="{line.color}" stroke-width="{width:g}"{dashes}'


def _pieces(x: Array, y: Array) -> Iterator[str]:
    """A path through the known values."""
    pen = "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(b):
            yield f"{pen}{a:.2f} {b:.2f}"
            pen = "L"
        else:
            pen = "M"


def _areas(x: Array, below: Array, above: Array) -> Iterator[str]:
    """Closed paths around the known values."""
    known = np.concatenate(([False], np.isfinite(below) & np.isfinite(above), [False]))
    edges = np.flatnonzero(known[1:] != known[:-1]).tolist()
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        part = slice(begin, end)
        yield "".join(_pieces(
            np.concatenate((x[part], x[part][::-1])),
            np.concatenate((above[part], below[part][::-1])),
        )) + "Z"  # fmt: skip


def _bar(bar: Bar, top: float, step: float, end_s: float) -> str:
    begin, end = _x(bar.begin_s, end_s), min(_x(bar.end_s, end_s), X1)
    high = HEIGHTS[bar.kind] * step
    y = top + step * (bar.row + 0.55) - 0.5 * high
    size = f'width="{max(end - begin, 0.1):.2f}" height="{high:.2f}"'
    return f'<rect class="{bar.kind}" x="{begin:.2f}" y="{y:.2f}" {size}/>'


def _limits(panel: Panel) -> tuple[float, float]:
    """Limits of the vertical axis: those of the values, with a margin."""
    values = np.concatenate([part for line in panel.lines for part in line.curve[1:]])
    values = np.clip(values[~np.isnan(values)], -_MOST, _MOST)
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    middle, half = 0.5 * (low + high), 0.55 * (high - low)
    half = max(half, 0.5 * panel.least, 1e-3 * abs(middle), 1e-3)
    return float(middle - half), float(middle + half)


def _ticks(low: float, high: float, most: int) -> Iterator[tuple[float, float]]:
    """At most about `most` round values from low to high, each with their distance."""
    rough = (high - low) / most
    step = 10.0 ** math.floor(math.log10(rough))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * step >= 0.999 * rough)
    for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield k * step, step


def _number(value: float, step: float) -> str:
    if abs(value) >= 1e6:
        return f"{value:.6g}"
    return f"{value + 0.0:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"


def _x(t_s: Any, end_s: float) -> Any:
    """Place on the paper of a time or an array of times."""
    return X0 + (X1 - X0) / end_s * t_s


def rule(kind: str, x0: float, y0: float, x1: float, y1: float) -> str:
    """A straight line; kind: its class, `grid` or `axis`."""
    return f'<line class="{kind}" x1="{x0:.2f}" y1="{y0:.2f}" x2="{x1:.2f}" y2="{y1:.2f}"/>'


def label(x: float, y: float, words: str, kind: str, more: str = "") -> str:
    """A text, whose characters XML must allow; kind: its class; more: attributes."""
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}"{more}>{words}</text>'
