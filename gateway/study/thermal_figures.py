"""Figures 4-8 of paper `thermal`: states, errors, jumps, motors and MAISD, detection."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags
from gateway.reports.figures import BLUE, GREEN, GREY, ORANGE
from gateway.study.reproduction_figures import save, subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS: Final = (BLUE, GREEN, "#CC79A7", ORANGE)
"""Colours of the four coaches, which differ in their dashes as well."""
DASHES: Final = ("-", "--", "-.", ":")
NAMES: Final = ("$x_1$ stator", "$x_2$ drive end", "$x_3$ non-drive end")


class Train(NamedTuple):
    """Data for the figures: one train of K samples and M motors.

    days (K,); fault: first and last day; odd: the motor with the fault; reading, true, state (K, M,
    3) degC; mixed (K, M) degC; beyond (K,): the odd motor's stator less the motors' mean, K; jumps
    (K - 1,): whether `beyond` jumps; detail (K - 1,): undecimated Haar details of `beyond`, level
    1; maisd (K, 3) K and its limits (3,).
    """

    days: Array
    fault: tuple[float, float]
    odd: int
    reading: Array
    true: Array
    state: Array
    mixed: Array
    beyond: Array
    detail: Array
    jumps: Flags
    maisd: Array
    limit: Array


def states(stem: Path, train: Train) -> None:
    """Figure 4: readings and estimated states of the odd motor, and its mixed state."""
    figure, axes = _points("°C")
    m = train.odd
    for p in range(3):
        axis = axes[p, 0]
        axis.plot(train.days, train.reading[:, m, p], ".", ms=3.0, color=GREY, label="reading")
        axis.plot(train.days, train.state[:, m, p], color=BLUE, lw=1.0, label="estimate")
    axes[3, 0].plot(train.days, train.mixed[:, m], color=BLUE, lw=1.0)
    axes[0, 0].legend(loc="upper right", ncols=2)
    _finish(stem, train, figure, f"Figure 4: states of the motor in coach {m + 1}")


def errors(stem: Path, train: Train) -> None:
    """Figure 5: estimates less the readings of a sensor without noise.

    For the mixed state, less the mean of these readings at the three points.
    """
    figure, axes = _points("error / K")
    m = train.odd
    mixed = train.mixed[:, m] - train.true[:, m].mean(axis=1)
    error = np.column_stack([train.state[:, m] - train.true[:, m], mixed])
    for axis, line in zip(axes[:, 0], error.T, strict=True):
        axis.plot(train.days, line, color=BLUE, lw=0.9)
        axis.axhline(0.0, color=GREY, lw=0.8)
    _finish(stem, train, figure, f"Figure 5: errors of the states, coach {m + 1}")


def _points(unit: str) -> tuple[Figure, Any]:
    """A figure, and its axes for the three points and the mixed state."""
    figure, axes = subplots(4, 1, (11.0, 9.0), sharex=True)
    for axis, name in zip(axes[:, 0], (*NAMES, "sigma-mixed"), strict=True):
        axis.set_ylabel(f"{name}\n{unit}")
    return figure, axes


def jumps(stem: Path, train: Train) -> None:
    """Figure 6: wavelet details over time and scale, and the jumps among those of level 1."""
    import pywt

    figure, axes = subplots(3, 1, (11.0, 8.0), sharex=True)
    axes[0, 0].plot(train.days, train.beyond, color=BLUE, lw=1.0)
    axes[0, 0].set_ylabel("stator less\nmotors' mean / K")
    scales = np.geomspace(1.0, 48.0, 24)
    power, _ = pywt.cwt(train.beyond - train.beyond.mean(), scales, "mexh")
    axes[1, 0].pcolormesh(train.days, scales, np.abs(power), shading="nearest", cmap="viridis",
                          rasterized=True)  # fmt: skip
    axes[1, 0].set_yscale("log")
    axes[1, 0].set_ylabel("scale / samples")
    axes[2, 0].plot(train.days[1:], train.detail, color=GREY, lw=0.9)
    where = np.flatnonzero(train.jumps)
    axes[2, 0].plot(train.days[1:][where], train.detail[where], "o", color=ORANGE, label="jump")
    axes[2, 0].set_ylabel("Haar detail, level 1\n(difference / √2) / K")
    if len(where):
        axes[2, 0].legend(loc="upper right")
    _finish(stem, train, figure, f"Figure 6: jump points of coach {train.odd + 1}", shade=False)


def motors(stem: Path, train: Train) -> None:
    """Figure 7: stator states of all coaches, and the three MAISD with their limits."""
    figure, axes = subplots(4, 1, (11.0, 10.0), sharex=True)
    for m in range(train.state.shape[1]):
        axes[0, 0].plot(
            train.days, train.state[:, m, 0], COLOURS[m % 4], lw=1.0, ls=DASHES[m % 4],
            label=f"coach {m + 1}",
        )  # fmt: skip
    axes[0, 0].set_ylabel("stator\n°C")
    axes[0, 0].legend(loc="upper right", ncols=4)
    for p in range(3):
        axis = axes[1 + p, 0]
        axis.plot(train.days, train.maisd[:, p], color=BLUE, lw=1.0, label="MAISD")
        axis.axhline(train.limit[p], color=ORANGE, ls="--", lw=1.2, label="limit")
        axis.set_ylabel(f"{NAMES[p]}\nMAISD / K")
    axes[1, 0].legend(loc="upper left", ncols=2)
    _finish(stem, train, figure, "Figure 7: motors of all coaches, and the spread between them")


def detection(stem: Path, train: Train, found: Mapping[str, tuple[Array, float]]) -> None:
    """Figure 8: every method's statistic (K,) with its limit."""
    figure, axes = subplots(len(found), 1, (11.0, 1.6 * len(found) + 1.2), sharex=True)
    for row, (name, (statistic, limit)) in enumerate(found.items()):
        axis = axes[row, 0]
        alarm = statistic > limit
        axis.plot(train.days, statistic, color=BLUE, lw=0.9)
        axis.plot(train.days[alarm], statistic[alarm], ".", ms=4.0, color=ORANGE)
        axis.axhline(limit, color=ORANGE, ls="--", lw=1.0)
        axis.set_ylabel(name)
    title = "Figure 8: statistics; dots: above the limit; shaded: the fault is there"
    _finish(stem, train, figure, title)


def _finish(stem: Path, train: Train, figure: Figure, title: str, *, shade: bool = True) -> None:
    """Title, time and grid; saves the figure. shade: while the fault is there."""
    for axis in figure.axes:
        axis.grid(alpha=0.3)
        if shade:
            axis.axvspan(*train.fault, color=ORANGE, alpha=0.12, lw=0)
    figure.axes[-1].set(xlabel="day", xlim=(0.0, train.days[-1]))
    figure.suptitle(title)
    save(figure, stem)
