"""Scoring of detectors: all measures of one run, pooled over runs, as a table.

The measures come from the frames that the gateway sends: flags from `Gateway_Adhesion`, loss
probability and load from `Drive{n}_Estimate`. May not know: where the frames came from.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array, Ints
from dbc.codec import Codec
from dbc.frame import Frame
from dbc.frames import block_of
from dbc.spec import VALID
from gateway.core.codes import INVALID, Flag, Health
from gateway.reports.scoring import Score, Truth, everyone, quantile, score_flag, truth_of
from gateway.reports.truth import Row

LEVELS: Final = 201
"""Values of `LossProbability` on the wire: 0 to 100 % in steps of 0.5 %."""
BINS: Final = 10
"""Bins of the reliability diagram."""


class Estimates(NamedTuple):
    """One drive's estimates: t_s (M,); probability (M,) 0..1 and load (M,) Nm, NaN if not sent."""

    t_s: Array
    probability: Array
    load_nm: Array


class GatewayOutput(NamedTuple):
    """Decoded output of the gateway in one run.

    t_s (T,); flags (T, N) and common (T,), values of `Flag`; estimates per drive.
    """

    t_s: Array
    flags: Ints
    common: Ints
    estimates: tuple[Estimates, ...]


class Measured(NamedTuple):
    """Measures of one run, or of several runs pooled.

    flags: score of the drives' flags; common: of `CommonMode`, against losses of all drives
    together. levels (2, LEVELS): number of judged estimates by truth (0 healthy, 1 lost) and
    probability. square_nm2, loads: sum of squared load errors, and their number.
    """

    flags: Score
    common: Score
    levels: Ints
    square_nm2: float
    loads: int

    @property
    def load_rmse_nm(self) -> float:
        """Root mean square of estimated minus true load; NaN if no load was estimated."""
        return math.sqrt(self.square_nm2 / self.loads) if self.loads else math.nan


def pooled(runs: Iterable[Measured]) -> Measured:
    """Pool all runs, one or more."""
    flags, common, levels, square_nm2, loads = zip(*runs, strict=True)
    scores = reduce(Score.plus, flags), reduce(Score.plus, common)
    return Measured(*scores, sum(levels), sum(square_nm2), sum(loads))


def listen(frames: Iterable[Frame], codec: Codec, nodes: Sequence[int]) -> GatewayOutput:
    """Decode the gateway's frames, in order; stamps count from 0 at the start of the run."""
    block = block_of(frames)

    def rows(name: str) -> tuple[Array, Array, NDArray[np.uint8]]:
        spec = codec.by_name[name]
        mine = np.flatnonzero(block.can_id == spec.can_id)
        index = np.full(len(mine), spec.index, dtype=np.int32)
        value, validity = codec.decode_rows(index, block.data[mine])
        return block.t_ns[mine] / 1e9, value, validity

    spec = codec.by_name["Gateway_Adhesion"]
    t_s, value, _ = rows(spec.name)
    states = value[:, [spec.column(f"Adhesion{node}") for node in nodes]]
    common = value[:, spec.column("CommonMode")]
    estimates = []
    for node in nodes:
        spec = codec.by_name[f"Drive{node}_Estimate"]
        when, value, validity = rows(spec.name)
        chance, load = spec.column("LossProbability"), spec.column("LoadTorque")
        tracked = value[:, spec.column("Health")] == Health.TRACKING
        estimates.append(
            Estimates(
                when,
                np.where(validity[:, chance] == VALID, value[:, chance] / 100.0, np.nan),
                np.where((validity[:, load] == VALID) & tracked, value[:, load], np.nan),
            )
        )
    return GatewayOutput(t_s, _states(states), _states(common), tuple(estimates))


def _states(value: Array) -> Ints:
    raw = np.nan_to_num(value).astype(np.int64)
    return np.where(raw == INVALID, int(Flag.UNKNOWN), raw)


def measure(rows: Sequence[Row], output: GatewayOutput, nodes: Sequence[int]) -> Measured:
    """Judge one run against the truth's rows."""
    truths = [truth_of(rows, node) for node in nodes]
    flags, common = Score(), Score()
    levels, square, loads = np.zeros((2, LEVELS), np.int64), 0.0, 0
    for k, (node, truth) in enumerate(zip(nodes, truths, strict=True)):
        flags = flags.plus(score_flag(truth, output.t_s, output.flags[:, k]))
        estimates = output.estimates[k]
        counted = truth.counted(estimates.t_s)
        lost = truth.lost[truth.at(estimates.t_s)]
        for true in (0, 1):
            known = estimates.probability[counted & (lost == bool(true))]
            known = known[np.isfinite(known)]
            raw = np.clip(np.rint(known * (LEVELS - 1)), 0, LEVELS - 1).astype(np.int64)
            levels[true] += np.bincount(raw, minlength=LEVELS)
        error = load_error(rows, node, truth, estimates.t_s, estimates.load_nm)
        error = error[np.isfinite(error)]
        square += float(error @ error)
        loads += len(error)
    if len(nodes) > 1:
        common = score_flag(everyone(truths), output.t_s, output.common)
    flags = flags._replace(train_s=flags.train_s / len(nodes))
    return Measured(flags, common, levels, square, loads)


def load_error(rows: Sequence[Row], node: int, truth: Truth, t_s: Array, load_nm: Array) -> Array:
    """(M,) error of a drive's estimated loads, Nm; NaN where the load is unknown or does not count.

    It counts in shallow losses, too: only edges and the start are left out.
    """
    true_nm = np.array([row.load_nm for row in rows if row.drive == node])
    settled = truth._replace(depth=np.ones_like(truth.depth))
    error = load_nm - true_nm[np.maximum(truth.at(t_s), 0)]
    return np.where(settled.counted(t_s), error, np.nan)


class Curve(NamedTuple):
    """Receiver operating characteristic: alarm at a probability of `threshold` or more.

    threshold, true_rate, false_rate (LEVELS + 1,): from no alarm (threshold above 1) to all alarms.
    """

    threshold: Array
    true_rate: Array
    false_rate: Array

    @property
    def area(self) -> float:
        """Area under the curve; NaN without losses or without healthy time."""
        return float(np.trapezoid(self.true_rate, self.false_rate))


def roc(levels: Ints) -> Curve:
    """Curve of the known probabilities, `Measured.levels`; NaN where a class is empty."""
    falling = np.concatenate([np.zeros((2, 1)), np.cumsum(levels[:, ::-1], axis=1)], axis=1)
    with np.errstate(invalid="ignore"):
        rates = falling / levels.sum(axis=1, keepdims=True)
    threshold = np.arange(LEVELS, -1, -1, dtype=np.float64) / (LEVELS - 1)
    return Curve(threshold, rates[1], rates[0])


class Reliability(NamedTuple):
    """Predicted and true share of losses, per bin of the probability (BINS,); NaN in empty bins."""

    predicted: Array
    true: Array
    frames: Ints

    @property
    def error(self) -> float:
        """Expected calibration error: mean |predicted - true|, weighted by the bins' frames."""
        full = self.frames > 0
        if not full.any():
            return math.nan
        gap = np.abs(self.predicted[full] - self.true[full])
        return float(gap @ self.frames[full] / self.frames.sum())


def reliability(levels: Ints) -> Reliability:
    """Bins of equal width over `Measured.levels`; 100 % belongs to the last."""
    level = np.arange(LEVELS) / (LEVELS - 1)
    place = np.minimum((np.arange(LEVELS) * BINS) // (LEVELS - 1), BINS - 1)
    both = levels.sum(axis=0)
    count = np.bincount(place, both, BINS)
    with np.errstate(invalid="ignore", divide="ignore"):
        predicted = np.bincount(place, both * level, BINS) / count
        true = np.bincount(place, levels[1], BINS) / count
    return Reliability(predicted, true, count.astype(np.int64))


class Line(NamedTuple):
    """One family and detector: its runs in the order of their seeds."""

    family: str
    detector: str
    seeds: tuple[int, ...]
    runs: tuple[Measured, ...]
    common: bool
    rated_nm: float

    @property
    def total(self) -> Measured:
        """All runs pooled."""
        return pooled(self.runs)

    def spread(self) -> tuple[float, float]:
        """Mean and standard deviation of F1 over the runs that have a loss; NaN without one."""
        each = [run.flags.f1 for run in self.runs if run.flags.losses]
        if not each:
            return math.nan, math.nan
        return float(np.mean(each)), float(np.std(each))


COLUMNS: Final = (
    "family", "detector", "runs", "F1", "F1 mean", "F1 sd", "F1 uncut", "precision", "recall",
    "false alarms / h", "losses", "missed", "delay ms", "delay 90 % ms", "delay abrupt ms",
    "adhering %", "unknown %", "false %", "dangerous %", "load rmse Nm", "load rmse %",
    "ROC area", "ECE", "common F1", "common delay ms", "common false / h",
)  # fmt: skip
"""Columns of the table, as `row` returns them."""


def row(line: Line) -> tuple[str | int | float, ...]:
    """Numbers of one line; NaN or infinite where it is not defined (F1 without a loss)."""
    total = line.total
    flags, common = total.flags, total.common
    of_losses = flags.f1, flags.uncut_f1, flags.precision, flags.recall, flags.dangerous_share
    f1, uncut_f1, precision, recall, dangerous_share = (
        value if flags.losses else math.nan for value in of_losses
    )
    return (
        line.family, line.detector, len(line.runs), f1, *line.spread(), uncut_f1, precision, recall,
        flags.alarms_per_hour, flags.losses, flags.missed, flags.median_delay_ms,
        quantile(flags.delays_ms, 0.9), quantile(flags.abrupt_ms, 0.5), 100.0 * flags.good_share,
        100.0 * flags.unknown_share, 100.0 * flags.false_share, 100.0 * dangerous_share,
        total.load_rmse_nm, 100.0 * total.load_rmse_nm / line.rated_nm, roc(total.levels).area,
        reliability(total.levels).error, common.f1 if line.common else math.nan,
        common.median_delay_ms if line.common else math.nan, common.alarms_per_hour,
    )  # fmt: skip
