"""Figures 5-9 of paper `adhesion`: true and estimated load, differences, histograms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.detect import GLOBAL_ESTIMATES
from gateway.io.whole_file import whole
from gateway.reports.figures import BLUE, GREEN, GREY, ORANGE, Span
from gateway.study.reproduction import METHODS, differences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RED: Final = "#C00000"
TITLES: Final = {
    "paper_vb": "variational Bayes",
    "vmp": "variational message passing",
    "kmeans": "k-means",
    "median": "median filtering",
}
WIDE_NM: Final = 10.0
"""A column of histograms with a wider range than this gets bins of 0.5 Nm, others 0.1 Nm."""
POINTS: Final = 1250
"""Number of stretches of a curve; the extremes of each are drawn, so that no peak is lost."""


class Picture(NamedTuple):
    """Data for the figures: t_s (T,), true and estimated load (T, N) Nm, stretches to shade."""

    t_s: Array
    true: Array
    estimated: Array
    spans: Sequence[Span]


def thinned(t_s: Array, values: Array, points: int = POINTS) -> tuple[Array, Array]:
    """Reduce a curve (T,) to the extremes of `points` stretches, in order of time."""
    size = len(values) // points
    if size < 3:
        return t_s, values
    count = len(values) // size
    blocks = values[: count * size].reshape(count, size)
    ends = np.stack([blocks.argmin(axis=1), blocks.argmax(axis=1)], axis=1)
    keep = np.unique(
        np.concatenate(
            [(np.sort(ends, axis=1) + size * np.arange(count)[:, None]).ravel(),
             np.arange(count * size, len(values)), [0, len(values) - 1]]
        )
    )  # fmt: skip
    return t_s[keep], values[keep]


def loads(stem: Path, picture: Picture, method: str) -> None:
    """Draw Figure 5-8 as `stem`.png and .svg: a row per drive, load left, difference right.

    Raises OSError.
    """
    n = picture.true.shape[1]
    common = GLOBAL_ESTIMATES[method](picture.estimated)
    difference = picture.estimated - common[:, None]
    figure, axes = subplots(n, 2, (13.0, 2.5 * n + 1.3), sharex=True)
    for d in range(n):
        left, right = axes[d]
        for axis in (left, right):
            for span in picture.spans:
                if span.drive == d + 1:
                    axis.axvspan(span.start_s, span.end_s, color=ORANGE, alpha=0.13, lw=0)
            axis.grid(alpha=0.3)
            axis.set_xlim(0.0, picture.t_s[-1])
        left.plot(*thinned(picture.t_s, picture.estimated[:, d]), color=BLUE, lw=1.0,
                  label="estimated load $M_z$")  # fmt: skip
        left.plot(*thinned(picture.t_s, common), color=GREEN, lw=1.0, ls=(0, (4, 3)),
                  label="global estimate $M_z^{(G)}$")  # fmt: skip
        left.plot(*thinned(picture.t_s, picture.true[:, d]), color=RED, lw=1.0, alpha=0.8,
                  label="true load")  # fmt: skip
        left.set_ylabel(f"PMSM {d + 1}\nload / Nm")
        right.plot(*thinned(picture.t_s, difference[:, d]), color=BLUE, lw=0.9)
        right.axhline(0.0, color=GREY, lw=0.8, zorder=0)
        right.set_ylabel("difference / Nm")
    axes[0, 0].set_title("load")
    axes[0, 1].set_title("$M_z - M_z^{(G)}$")
    for axis in axes[-1]:
        axis.set_xlabel("time / s (8000 samples per second)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if any(s.drive <= n for s in picture.spans):
        from matplotlib.patches import Patch

        handles.append(Patch(color=ORANGE, alpha=0.2))
        labels.append("this drive has lost load")
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    number = 5 + list(METHODS).index(method)
    figure.suptitle(f"Figure {number}: loads and differences with {TITLES[method]}")
    save(figure, stem)


def histograms(stem: Path, picture: Picture) -> None:
    """Draw Figure 9 as `stem`.png, .svg: a row per method, a column per drive. Raises OSError."""
    n = picture.true.shape[1]
    every = differences(picture.estimated)
    figure, axes = subplots(len(every), n, (4.1 * n, 9.4), sharey=True)
    for d in range(n):
        column = np.concatenate([difference[:, d] for difference in every.values()])
        width = 0.5 if np.ptp(column) > WIDE_NM else 0.1
        first, last = np.floor(column.min() / width), np.ceil(column.max() / width)
        bins = width * (np.arange(first, last + 2.0) - 0.5)
        for m, (method, difference) in enumerate(every.items()):
            axis = axes[m, d]
            axis.hist(difference[:, d], bins=bins, color=BLUE, log=True)
            axis.minorticks_off()
            axis.grid(alpha=0.3)
            axis.set_xlim(bins[0] - width, bins[-1] + width)
            if d == 0:
                axis.set_ylabel(f"{METHODS[method]}\nsamples")
            if m == 0:
                axis.set_title(f"PMSM {d + 1} (bins of {width} Nm)")
            if m == len(every) - 1:
                axis.set_xlabel("$M_z - M_z^{(G)}$ / Nm")
    figure.suptitle("Figure 9: histograms of the differences, logarithmic counts")
    save(figure, stem)


def subplots(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> Any:
    """A figure and its axes (rows, columns), drawn without a screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    return plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained", **shared)


def save(figure: Figure, stem: Path) -> None:
    """Save PNG and SVG without date and random names: the same numbers give the same bytes."""
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    with whole(stem.with_suffix(".png")) as part:
        figure.savefig(part, dpi=110, metadata={"Software": None})
    figure.set_layout_engine("none")  # layout takes most of the time, so it is done only once
    with mpl.rc_context({"svg.hashsalt": "section 5"}), whole(stem.with_suffix(".svg")) as part:
        figure.savefig(part, metadata={"Date": None})
    plt.close(figure)
