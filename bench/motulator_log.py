"""Waveforms of a machine that is not ours: as frames in a log, replayed and judged.

Only the machine is another: sensors, messages, arbitration and truth are the simulator's, so that
the same run with our own machine differs in nothing else. Knows nothing of where waveforms come
from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.candump.writer import Writer
from dbc.codec import Codec
from dbc.frame import Frame
from gateway.core.gateway import Gateway
from gateway.io.replay import OneChannel, open_log, replay
from gateway.reports.scoring import quantile, truth_of
from gateway.settings.config import Config
from gateway.study.evaluation import GatewayOutput, Measured, listen, measure, nothing
from gateway.study.held_world import periods
from sim.ground_truth import Truth
from sim.simulation import GRID, GRID_NS, Simulation

Array = NDArray[np.float64]


def write_log(simulation: Simulation, path: Path) -> list[Truth]:
    """Run a whole scenario into a candump log; what was true, a row per drive every 10 ms."""
    with Writer(path, "vcan0") as writer:
        for tick in range(periods(simulation.scenario) // GRID + 1):
            for frame in simulation.step((), tick * GRID_NS):
                writer.write(frame)
    return simulation.truth_rows()


def replay_log(path: Path, config: Config, codec: Codec) -> list[Frame]:
    """What a fresh gateway sends over a log. Raises BadLogError or LogError."""
    sent: list[Frame] = []
    replay(
        OneChannel(open_log(path, strict=True).blocks, None),
        lambda start_ns: Gateway(config, codec, start_ns),
        config.loop.period_ns,
        lambda _now, out, _gateway: sent.extend(out),
    )
    return sent


class Judged(NamedTuple):
    """One run or several: all that `evaluate` measures, and load errors of healthy times alone."""

    measured: Measured = nothing()
    square_nm2: float = 0.0
    loads: int = 0

    def plus(self, other: Judged) -> Judged:
        """Both pooled."""
        return Judged(
            self.measured.plus(other.measured),
            self.square_nm2 + other.square_nm2,
            self.loads + other.loads,
        )

    @property
    def healthy_rmse_nm(self) -> float:
        """Root mean square load error while the drive adheres; NaN where nothing was estimated."""
        return math.sqrt(self.square_nm2 / self.loads) if self.loads else math.nan


def judge(rows: Sequence[Truth], sent: Sequence[Frame], codec: Codec) -> Judged:
    """Judge what a gateway sent in one run."""
    nodes = tuple(dict.fromkeys(row.drive for row in rows))
    output = listen(sent, codec, nodes)
    errors = _healthy_errors(rows, output, nodes)
    return Judged(measure(rows, output, nodes), float(errors @ errors), len(errors))


def _healthy_errors(rows: Sequence[Truth], output: GatewayOutput, nodes: Sequence[int]) -> Array:
    """Estimated minus true load, Nm, of healthy drives while tracked; edges and start left out."""
    errors = []
    for node, estimates in zip(nodes, output.estimates, strict=True):
        truth = truth_of(rows, node)
        true_nm = np.array([row.load_nm for row in rows if row.drive == node])
        row = np.maximum(truth.at(estimates.t_s), 0)
        judged = truth.counted(estimates.t_s) & ~truth.lost[row]
        error = (estimates.load_nm - true_nm[row])[judged]
        errors.append(error[np.isfinite(error)])
    return np.concatenate(errors)


HEADER: Final = (
    "machine", "family", "bus", "runs", "F1", "precision", "recall", "losses", "missed",
    "delay ms", "delay abrupt ms", "adhering %", "false losses", "load rmse Nm healthy",
    "load rmse Nm all",
)  # fmt: skip
LEGEND: Final = """\
Per drive and flag frame, 30 ms around each edge and the first 0.5 s left out; unknown counts as not
raised. Delay: median from the onset to the first `AdhesionLost`, of the losses found; abrupt: half
of the demand gone within 20 ms. False losses: stretches of `AdhesionLost` that touch no loss.
Adhering: share of healthy frames. Load: estimated minus true while tracking."""


def cells(names: Sequence[str], runs: int, judged: Judged) -> list[str]:
    """One line of the table; `names`: machine, family and bus."""
    flags = judged.measured.flags
    return [
        *names,
        str(runs),
        *(f"{share:.4f}" for share in (flags.f1, flags.precision, flags.recall)),
        str(flags.losses),
        str(flags.missed),
        *(_median(delays) for delays in (flags.delays_ms, flags.abrupt_ms)),
        f"{100.0 * flags.good_share:.2f}",
        str(flags.alarms),
        f"{judged.healthy_rmse_nm:.3f}",
        f"{judged.measured.load_rmse_nm:.3f}",
    ]


def _median(delays_ms: Sequence[float]) -> str:
    return f"{quantile(delays_ms, 0.5):.0f}" if delays_ms else "-"


def table(lines: Sequence[Sequence[str]]) -> str:
    """All lines as a Markdown table."""
    rows = [HEADER, ["---"] * len(HEADER), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
