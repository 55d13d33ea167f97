"""Pictures of a run: values over time, flags as strips below, on one time axis.

The colours are those of Okabe and Ito, which colour-blind people can distinguish; line style,
height or hatch always shows the same as a colour. The same run gives the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from dbc.text import printable
from gateway.core.codes import Flag
from gateway.io.whole_file import whole, write_text
from gateway.reports.trace import RANK, Curve, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gateway.reports.truth import Truth

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#999999"
PURPLE, SKY, YELLOW, DARK = "#CC79A7", "#56B4E9", "#E69F00", "#444444"
WIDTH_IN: Final = 9.0
_LEFT_IN, _RIGHT_IN, _FOOT_IN, _GAP_IN, _NAMES_IN = 0.95, 0.15, 0.75, 0.14, 0.18
LEFT: Final = _LEFT_IN / WIDTH_IN
RIGHT: Final = 1.0 - _RIGHT_IN / WIDTH_IN
"""Ends of the time axis, as shares of the width of a picture."""
_STYLE: Final[dict[str, Any]] = {
    "svg.hashsalt": "traction-gateway",
    # Text stays text: it can be searched and copied, and the file is a third of the size.
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": DARK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "hatch.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "xtick.color": DARK,
    "ytick.color": DARK,
}
_BARS: Final[Mapping[Flag, dict[str, Any]]] = {
    Flag.GOOD: {"facecolor": GREEN, "edgecolor": "none"},
    Flag.UNKNOWN: {"facecolor": "white", "edgecolor": GREY, "hatch": "//////", "linewidth": 0.4},
    Flag.BAD: {"facecolor": ORANGE, "edgecolor": "black", "linewidth": 0.5},
}
_HEIGHT: Final = {Flag.GOOD: 0.28, Flag.UNKNOWN: 0.6, Flag.BAD: 0.86}
_FLAG: Final = {rank: flag for flag, rank in RANK.items()}
_METADATA: Final = re.compile(r"<metadata>.*?</metadata>\s*", re.DOTALL)
_DOCTYPE: Final = re.compile(r"<!DOCTYPE[^>]*>\s*")
_PATH: Final = re.compile(r' d="[^"]*"')
_DIGITS: Final = re.compile(r"(?<=\.\d\d)\d+")


class Span(NamedTuple):
    """An interval of truth to draw: start and end in seconds, drive, name."""

    start_s: float
    end_s: float
    drive: int
    name: str


class Panel(NamedTuple):
    """One pair of axes of a figure: height in inches, label, whether a legend is above it."""

    height: float
    label: str
    names: bool = False


def save(figure: Figure, path: Path) -> None:
    """Write PNG or, by the suffix, SVG, without dates, references and digits that are invisible."""
    if path.suffix != ".svg":
        with whole(path) as part:
            figure.savefig(part, dpi=110, metadata={"Software": None})
        return
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg", metadata={"Date": None})
    text = _METADATA.sub("", _DOCTYPE.sub("", drawn.getvalue()))
    # Two decimals are enough: a hundredth of a point is finer than any printer.
    text = _PATH.sub(lambda found: _DIGITS.sub("", found[0]), text)
    write_text(path, text)


@contextmanager
def styled() -> Iterator[None]:
    """Context to draw and save the figures of this module, without the user's own settings."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)  # type: ignore[arg-type]
        yield


def panels(wanted: Sequence[Panel], top_in: float = 0.12) -> Any:
    """A figure with these panels below one another, on one time axis: (figure, axes)."""
    from matplotlib.figure import Figure

    # Sizes are given in inches, because a layout engine draws everything twice.
    gaps = _GAP_IN * (len(wanted) - 1) + _NAMES_IN * sum(p.names for p in wanted)
    high = top_in + _FOOT_IN + sum(p.height for p in wanted) + gaps
    figure = Figure(figsize=(WIDTH_IN, high))
    axes: list[Axes] = []
    y = high - top_in
    for panel in wanted:
        y -= panel.height + _NAMES_IN * panel.names
        box = (
            LEFT, y / high, RIGHT - LEFT, panel.height / high,
        )  # fmt: skip
        axis = figure.add_axes(box, sharex=axes[0] if axes else None)
        axis.set_ylabel(panel.label)
        # All labels are in one column, whatever the width of the numbers beside them.
        axis.yaxis.set_label_coords(-0.5 / (WIDTH_IN - _LEFT_IN - _RIGHT_IN), 0.5)
        axis.tick_params(labelbottom=panel is wanted[-1], length=2.5)
        axes.append(axis)
        y -= _GAP_IN
    axes[-1].set_xlabel("time / s")
    return figure, axes


def line(axis: Axes, curve: Curve, *, color: str, label: str, **style: Any) -> None:
    """Draw a curve; if ticks were merged, also the band from their smallest to largest value."""
    style = {"lw": 1.1, **style}
    if np.array_equal(curve.low, curve.high, equal_nan=True):
        axis.plot(*broken(curve.t_s, curve.low), color=color, label=label, **style)
        return
    t_s, low, high = broken(curve.t_s, curve.low, curve.high)
    axis.fill_between(t_s, low, high, color=color, lw=0, alpha=0.45)
    axis.plot(t_s, 0.5 * (low + high), color=color, label=label, **{**style, "lw": 0.9})


def true_line(axis: Axes, curve: Curve) -> None:
    """Draw a true value, on top of its estimate."""
    line(axis, curve, color="black", label="true", lw=0.9, ls=(0, (4, 2)))


def broken(t_s: Any, *values: Any) -> list[Any]:
    """The same arrays with a NaN in every gap of time, so that no line crosses it."""
    if len(t_s) < 3:
        return [t_s, *values]
    steps = np.diff(t_s)
    holes = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1
    return [np.insert(t_s, holes, t_s[holes - 1]), *(np.insert(v, holes, np.nan) for v in values)]


def strip(axis: Axes, row: int, curve: Curve, end_s: float) -> None:
    """Draw one flag as bars; `curve` holds ranks of `trace.RANK`, of merged ticks the worst."""
    rank = curve.high
    if not len(rank):
        return
    begins = np.flatnonzero(np.concatenate(([True], np.diff(rank) != 0)))
    ends = np.append(curve.t_s[begins[1:]], end_s)
    for flag, style in _BARS.items():
        mine = [k for k, b in enumerate(begins.tolist()) if _FLAG[rank[b]] is flag]
        if mine:
            bars = [(curve.t_s[begins[k]], max(ends[k] - curve.t_s[begins[k]], 1e-9)) for k in mine]
            high = _HEIGHT[flag]
            axis.broken_barh(bars, (row - 0.5 * high, high), **style)


def strips(axis: Axes, names: Sequence[str]) -> None:
    """Prepare an axis for strips, with a row for each name from the top."""
    axis.set_yticks(range(len(names)), list(names))
    axis.set_ylim(len(names) - 0.45, -0.55)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)
    axis.spines["left"].set_visible(False)


def key(good: str, bad: str) -> list[Any]:
    """Legend handles for strips."""
    from matplotlib.patches import Patch

    return [Patch(label=word, **_BARS[flag])
               for flag, word in ((Flag.GOOD, f"{good} (thin)"), (Flag.BAD, f"{bad} (tall)"),
                                  (Flag.UNKNOWN, "Unknown (hatched)"))]  # fmt: skip


def legend(axis: Axes, columns: int = 4) -> None:
    """Put the legend above the panel, in one line, so that it hides nothing."""
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.1,
                    handlelength=1.8, columnspacing=1.2)  # fmt: skip


def foot(figure: Figure, handles: list[Any]) -> None:
    """Put the legend of the strips at the bottom of the figure."""
    figure.legend(handles=handles, loc="lower left", ncols=len(handles), handlelength=1.8,
                  bbox_to_anchor=(LEFT - 0.012, 0.0), columnspacing=1.4)  # fmt: skip


def nothing(axis: Axes, text: str) -> None:
    """Write a text into a panel without values."""
    axis.text(0.5, 0.5, text, ha="center", va="center", transform=axis.transAxes, color="#666666")
    axis.set_yticks([])


def load_panel(axis: Axes, trace: Trace, node: int, truth: Truth | None) -> None:
    """Draw the load torque: the estimate with its band, and the true value if it is known."""
    from matplotlib.patches import Patch

    estimate = trace.curve(node, "load_nm")
    true = None if truth is None else truth.load(node)
    handles = []
    if estimate.known:
        low, high = trace.curve(node, "low_nm"), trace.curve(node, "high_nm")
        t_s, below, above = broken(estimate.t_s, low.low, high.high)
        axis.fill_between(t_s, below, above, color=SKY, alpha=0.35, lw=0)
        line(axis, estimate, color=BLUE, label="estimated")
        handles = [Patch(color=SKY, alpha=0.35, lw=0, label="its 2 sigma band")]
    elif true is None:
        nothing(axis, "the load was never known")
        return
    if true is not None:
        true_line(axis, true)
    axis.legend(
        handles=[*axis.get_legend_handles_labels()[0], *handles], loc="lower left",
        bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.1, handlelength=1.8,
    )  # fmt: skip


def loads(
    path: Path, trace: Trace, title: str, truth: Truth | None = None, spans: Sequence[Span] = ()
) -> None:
    """Write a figure: load and band of every drive, truth if known, adhesion flags as strips."""
    nodes, end_s = trace.nodes, trace.span_s
    wanted = [Panel(1.15, f"drive {node}\nload / Nm", node == nodes[0]) for node in nodes]
    wanted.append(Panel(0.3 + 0.24 * len(nodes), ""))
    with styled():
        figure, axes = panels(wanted, top_in=0.35)
        for node, axis in zip(nodes, axes, strict=False):
            for span in spans:
                if span.drive == node:
                    axis.axvspan(span.start_s, span.end_s, color=ORANGE, alpha=0.15, lw=0)
            load_panel(axis, trace, node, truth)
            if node != nodes[0] and (names := axis.get_legend()) is not None:
                names.remove()
        for row, node in enumerate(nodes):
            strip(axes[-1], row, trace.curve(node, "adhesion"), end_s)
        strips(axes[-1], [f"drive {node}" for node in nodes])
        handles = key("Adhering", "AdhesionLost")
        if spans:
            from matplotlib.patches import Patch

            # Without this text, a flag that clears within a shaded span looks wrong.
            shade = "rail below demand (a drive that cut its torque adheres)"
            handles.append(Patch(color=ORANGE, alpha=0.15, lw=0, label=shade))
        foot(figure, handles)
        # A title is not a formula, and XML has no control characters.
        figure.text(
            LEFT, 1 - 0.12 / figure.get_figheight(), printable(title),
            va="top", fontweight="bold", parse_math=False,
        )  # fmt: skip
        axes[0].set_xlim(0.0, max(end_s, 1e-3))
        save(figure, path)
