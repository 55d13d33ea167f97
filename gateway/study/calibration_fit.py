"""How well a calibration explains its motors, on fault-free data that was held back from the fit.

The model runs without correction over the held-back data, starting at its first readings. The
first half of the residuals gives the usual error; the second half shows whether it stays so.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.model import inputs_of, predict
from estimators.thermal.monitor import MOST_FALSE, Coverage, Known
from estimators.thermal.record import POINTS, Record, mean_of_known
from estimators.thermal.system_identification import first_readings

LEAST_INSIDE: Final = 0.8
"""Least share of the second half within two sigma; normal errors would be inside for 95 %."""


class Fit(NamedTuple):
    """Fit of one motor, on K seconds; NaN: the motor has no such sensor.

    t_s (K,); measured_c and modelled_c (K, 3) at `POINTS`; sigma_k (3,) of the first half; error_k
    (3,): root mean square over both halves; inside (3,): share of the second half within two sigma.
    """

    node: int
    t_s: Array
    measured_c: Array
    modelled_c: Array
    sigma_k: Array
    error_k: Array
    inside: Array

    @property
    def explained(self) -> bool:
        """Whether each sensor stays within the band of the first half (`LEAST_INSIDE`)."""
        return bool((np.nan_to_num(self.inside, nan=1.0) >= LEAST_INSIDE).all())


def fits(known: Known, held_back: Record, nodes: Sequence[int]) -> list[Fit]:
    """Fit of each motor, in the order of `nodes`."""
    modelled = predict(known.parameters, inputs_of(held_back), first_readings(held_back))
    off = held_back.temperature - modelled
    half = len(off) // 2
    with np.errstate(all="ignore"):
        centre = mean_of_known(off[:half])
        sigma: Array = np.sqrt(mean_of_known((off[:half] - centre) ** 2))
        error: Array = np.sqrt(mean_of_known(off**2))
        later = np.where(
            np.isfinite(off[half:]), np.abs(off[half:] - centre) <= 2.0 * sigma, np.nan
        )
        inside = mean_of_known(later)
    t_s = (held_back.at * held_back.step_s).astype(np.float64)
    return [
        Fit(
            node, t_s, held_back.temperature[:, j], modelled[:, j] + centre[j], sigma[j], error[j],
            inside[j],
        )
        for j, node in enumerate(nodes)
    ]  # fmt: skip


def filter_lines(coverage: Coverage, nodes: Sequence[int]) -> list[str]:
    """A line for each motor with a measured coverage, and a note on filters that do not hold."""
    out = [
        f"drive {node}: filters widened {inflation:.2f} times; their 95 % band then contains "
        f"{100.0 * light:.0f} % of the blocks with low and {100.0 * heavy:.0f} % of those with "
        f"high copper loss; correlation from block to block {lag_one:.2f}"
        for node, inflation, (light, heavy), lag_one, _ in zip(nodes, *coverage, strict=True)
        if np.isfinite(lag_one)
    ]
    for node, uncovered, false_share in zip(
        nodes, coverage.uncovered, coverage.false_share, strict=True
    ):
        unknown = f"note: drive {node} will be Unknown with reason Config:"
        if uncovered:
            out.append(
                f"{unknown} the filters do not fit it; record fault-free logs with the same duty "
                "as the others"
            )
        elif false_share > MOST_FALSE:
            out.append(
                f"{unknown} it seems faulty for {100.0 * false_share:.0f} % of these logs; if it "
                "is sound, its model is wrong: record more logs, of all kinds of duty"
            )
    return out


def lines(found: Sequence[Fit]) -> list[str]:
    """A line for each motor, and a note if there are motors that the model does not explain."""
    hours = (found[0].t_s[-1] - found[0].t_s[0]) / 3600.0
    out = [
        f"On {hours:.2f} h held back from the fit: model error, and share of the second half "
        "within two sigma of the first half"
    ]
    for fit in found:
        parts = [
            f"{name} {error:.2f} K, {100.0 * inside:.0f} %"
            for name, error, inside in zip(POINTS, fit.error_k, fit.inside, strict=True)
            if np.isfinite(error)
        ]
        out.append(f"drive {fit.node}: {'; '.join(parts)}")
    badly = [str(fit.node) for fit in found if not fit.explained]
    if badly:
        out.append(
            f"note: the model does not explain drive {', '.join(badly)} as well in the second "
            "half; record more or longer duty cycles, otherwise limits are too tight"
        )
    return out


def draw(folder: Path, found: Sequence[Fit]) -> list[Path]:
    """Draw `drive<n>.svg` of each motor: measured, modelled, and the residual with its band."""
    from gateway.reports import figures

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    rows = [
        figures.Panel(2.2, "temperature / degC", True),
        figures.Panel(1.4, "measured - model / K", False),
    ]
    with figures.styled():
        for fit in found:
            figure, (above, below) = figures.panels(rows)
            for p, color in enumerate((figures.BLUE, figures.ORANGE, figures.GREEN)):
                if not np.isfinite(fit.error_k[p]):
                    continue
                above.plot(fit.t_s, fit.measured_c[:, p], color=color, lw=1.0, label=POINTS[p])
                above.plot(fit.t_s, fit.modelled_c[:, p], color=color, lw=1.0, ls="--")
                left = fit.measured_c[:, p] - fit.modelled_c[:, p]
                below.plot(fit.t_s, left, color=color, lw=0.8)
                for sign in (-2.0, 2.0):
                    below.axhline(sign * fit.sigma_k[p], color=color, lw=0.6, ls=":")
            above.plot([], [], color=figures.GREY, ls="--", label="model")
            figures.legend(above)
            paths.append(folder / f"drive{fit.node}.svg")
            figures.save(figure, paths[-1])
    return paths
