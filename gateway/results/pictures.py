"""Pictures of a run: load and flags over time, one row per drive, shared time axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gateway.results.record import Series

# Colour-blind safe (Okabe-Ito); the flags also differ by place and hatch.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#999999"


class Span(NamedTuple):
    """A stretch of truth to shade: seconds, drive, name."""

    start_s: float
    end_s: float
    drive: int
    name: str


def loads(
    path: Path,
    series: Mapping[int, Series],
    title: str,
    truth: Mapping[int, tuple[Sequence[float], Sequence[float]]] | None = None,
    spans: Sequence[Span] = (),
) -> None:
    """Estimated load with its band, truth where known, and the flag as a strip below.

    truth: per drive (t_s, load_nm).
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Rectangle

    n = len(series)
    figure, axes = plt.subplots(
        n + 1, 1, sharex=True, figsize=(10, 1.9 * n + 1.6), squeeze=False,
        gridspec_kw={"height_ratios": [3] * n + [0.45 * n]}, layout="constrained",
    )  # fmt: skip
    strip = axes[n, 0]
    for row, (node, data) in enumerate(series.items()):
        axis = axes[row, 0]
        t = np.array(data.t_s)
        load, sigma = np.array(data.load_nm), np.array(data.sigma_nm)
        for span in spans:
            if span.drive == node:
                axis.axvspan(span.start_s, span.end_s, color=ORANGE, alpha=0.15, lw=0)
        if truth and node in truth:
            axis.plot(*truth[node], color=GREY, lw=1.6, label="true load")
        axis.fill_between(t, load - 2 * sigma, load + 2 * sigma, color=BLUE, alpha=0.2, lw=0)
        axis.plot(t, load, color=BLUE, lw=0.9, label="estimated, 2 sigma band")
        axis.set_ylabel(f"drive {node}\nload / Nm")
        axis.margins(x=0)
        axis.grid(alpha=0.3)
        _flags(strip, row, t, np.array(data.adhesion))
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize="small")
    axes[0, 0].set_title(title)
    strip.set_yticks(range(n), [f"drive {node}" for node in series])
    strip.set_ylim(n - 0.5, -0.5)
    strip.set_xlabel("time / s")
    strip.set_ylabel("flag")
    handles = [
        Rectangle((0, 0), 1, 1, color=GREEN, label="Adhering"),
        Rectangle((0, 0), 1, 1, color=ORANGE, label="AdhesionLost"),
        Rectangle((0, 0), 1, 1, fc="white", ec=GREY, hatch="////", label="Unknown"),
    ]
    if spans:
        # Or a flag that clears within one looks wrong.
        shade = "rail below the train's demand (a drive that cut its torque adheres)"
        handles.append(Rectangle((0, 0), 1, 1, color=ORANGE, alpha=0.15, lw=0, label=shade))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small")
    figure.savefig(path, dpi=110, metadata={"Software": None} if path.suffix == ".png" else None)
    plt.close(figure)


def _flags(axis: object, row: int, t: np.ndarray, flag: np.ndarray) -> None:
    """One strip of coloured bars per run of equal flags."""
    if not len(t):
        return
    edges = np.flatnonzero(np.diff(flag)) + 1
    starts = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(t) - 1]))
    for a, b in zip(starts, ends, strict=True):
        style = {
            0: {"facecolor": "white", "edgecolor": GREY, "hatch": "////"},
            1: {"facecolor": GREEN, "edgecolor": GREEN},
            2: {"facecolor": ORANGE, "edgecolor": ORANGE},
        }[int(flag[a])]
        axis.broken_barh([(t[a], max(t[b] - t[a], 1e-9))], (row - 0.38, 0.76), lw=0.4, **style)  # type: ignore[attr-defined]
