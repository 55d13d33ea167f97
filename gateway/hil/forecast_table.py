"""The smallest loss that is detected in time, by drive, speed and torque: table and picture."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.channel import RPM
from gateway.hil.forecast import Forecast
from gateway.io.whole_file import write_text

if TYPE_CHECKING:
    from dbc.codec import Codec
    from gateway.settings.config import Config

    Array = NDArray[np.float64]

SPEEDS: Final = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Shares of rated speed."""
TORQUES: Final = (0.5, 1.0)
"""Shares of rated torque."""
LOSSES: Final = (
    1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.25, 0.22, 0.2, 0.18, 0.16, 0.15, 0.14, 0.13, 0.12, 0.11, 0.1,
    0.09, 0.08, 0.07, 0.06, 0.05,
)  # fmt: skip
"""Lost shares of the load, largest first."""
SURE: Final = 0.9
"""Share of the cases in which a loss must be found in time to count as found in time."""


WITHIN_MS: Final = (50, 200)
TICKS_MS: Final = (10, 20, 50, 100, 200)


class Cell(NamedTuple):
    """One motor, speed and torque. delays_ms: (cases,) by loss; problem: why it is empty."""

    nodes: tuple[int, ...]
    motor: str
    rpm: float
    torque: float
    delays_ms: dict[float, Array]
    problem: str = ""

    def smallest(self, within_ms: float) -> float | None:
        """Smallest loss that, like all larger ones, is found in time; None: the largest is not."""
        found = None
        for loss, delays in self.delays_ms.items():
            if (delays <= within_ms).mean() < SURE:
                break
            found = loss
        return found


def cells(config: Config, codec: Codec, rated_rpm: float, ended: Callable[[], None]) -> list[Cell]:
    """Forecasts for the first drive of each motor and kind of inverter.

    ended: called after each speed and torque. Raises ConfigError as `Gateway` does.
    """
    alike: dict[tuple[str, str | None], list[int]] = defaultdict(list)
    for place, drive in enumerate(config.drive):
        dbc = drive.signals.dbc if drive.signals else None
        alike[drive.motor, dbc].append(place)
    out = []
    for share in SPEEDS:
        for torque in TORQUES:
            rpm, problem, forecast = share * rated_rpm, "", None
            try:
                forecast = Forecast(config, codec, rpm * RPM, torque)
            except ValueError as error:
                problem = str(error)
            for (motor, _), places in alike.items():
                nodes = tuple(config.nodes[place] for place in places)
                delays = _delays(forecast, places[0]) if forecast else {}
                out.append(Cell(nodes, motor, rpm, torque, delays, problem))
            ended()
    return sorted(out, key=lambda cell: cell.nodes)


def _delays(forecast: Forecast, drive: int) -> dict[float, Array]:
    """Delays by loss, down to the first loss that is not found in about half of the cases."""
    out: dict[float, Array] = {}
    for loss in LOSSES:
        out[loss] = forecast.delays_ms(drive, loss)
        if np.isinf(np.median(out[loss])):
            break
    return out


def write_forecast(folder: Path, of: Sequence[Cell]) -> list[Path]:
    """Write `forecast.csv` and `forecast.svg`; return their paths."""
    lines = ["drives,motor,speed_rpm,torque_percent,loss_percent,found_percent,median_ms,p90_ms"]
    for cell in of:
        nodes = " ".join(map(str, cell.nodes))
        for loss, delays in cell.delays_ms.items():
            median, p90 = np.quantile(delays, (0.5, SURE), method="higher")
            lines.append(
                f"{nodes},{cell.motor},{cell.rpm:g},{100 * cell.torque:g},{100 * loss:g},"
                f"{100 * np.isfinite(delays).mean():g},{median:.1f},{p90:.1f}"
            )
    folder.mkdir(parents=True, exist_ok=True)
    table, picture = folder / "forecast.csv", folder / "forecast.svg"
    write_text(table, "\n".join(lines) + "\n")
    _draw(picture, of)
    return [table, picture]


def _draw(path: Path, of: Sequence[Cell]) -> None:
    """Draw median delay over loss: a panel per kind of drive and torque, a line per speed."""
    from matplotlib.figure import Figure

    from gateway.reports import figures

    groups = list(dict.fromkeys(cell.nodes for cell in of))
    with figures.styled():
        figure = Figure(figsize=(figures.WIDTH_IN, 3.2 * len(groups)), layout="constrained")
        axes = figure.subplots(len(groups), len(TORQUES), sharex=True, sharey=True, squeeze=False)
        colours = (figures.BLUE, figures.ORANGE, figures.GREEN, figures.PURPLE, figures.SKY)
        looks = list(zip(colours, "os^Dv", strict=True))
        for cell in of:
            axis = axes[groups.index(cell.nodes), TORQUES.index(cell.torque)]
            colour, marker = looks[len(axis.lines) % len(looks)]
            found = {loss: np.median(ms) for loss, ms in cell.delays_ms.items()}
            axis.plot(
                [100.0 * loss for loss in found], list(found.values()), marker=marker, ms=3.0,
                lw=1.0, color=colour, label=f"{cell.rpm:.0f} rpm",
            )  # fmt: skip
            axis.set_title(f"motor {cell.motor}, {100 * cell.torque:.0f} % of rated torque")
        for axis in axes.flat:
            axis.set_yscale("log")
            axis.set_yticks(TICKS_MS, [str(ms) for ms in TICKS_MS])
            axis.minorticks_off()
            if axis.lines:
                axis.legend()
            for within_ms in WITHIN_MS:
                axis.axhline(within_ms, color=figures.DARK, lw=0.8, ls="--")
        figure.supxlabel("loss of one drive / % of its load")
        figure.supylabel("median delay until AdhesionLost / ms")
        figures.save(figure, path)
