"""The product's thermal method: a calibrated model for each motor, hypotheses on its residual.

`model` is identified on the first part of the fault-free data, the residuals' spread on the rest:
limits from data that the fit has used would be too tight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dbc.arrays import Array
from dbc.records import Records
from estimators.thermal import coverage, hypotheses, model
from estimators.thermal.hypotheses import KINDS, SNAPSHOTS, Belief, Spread
from estimators.thermal.model import inputs_of, predict, simulate
from estimators.thermal.monitor import LONGEST_BLOCK_S, Known, ThermalMonitor, followed
from estimators.thermal.record import Record, mean_of_known, of_driven_motors, spacing, split
from estimators.thermal.system_identification import first_readings, identify

SCALES = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
"""Scales of the disturbances that are tried; the likeliest on fault-free data is taken."""
OWN_K = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Random deviations of a lump that are tried, K per root of a minute: the error of a model with
five lumps. The likeliest, together with the scale, is taken."""


@dataclass(frozen=True)
class Calibrated:
    """A train's motors, calibrated on fault-free data, for samples hours apart."""

    parameters: Array
    spread: Spread

    def believe(self, record: Record) -> Belief:
        """Probabilities of every kind of fault; causal apart from the record's mean signatures."""
        first = first_readings(record)
        residual = record.temperature - predict(self.parameters, inputs_of(record), first)
        shapes = hypotheses.signatures(self.parameters, inputs_of(record), first)
        return hypotheses.believe(residual, self.spread, shapes)

    def __call__(self, record: Record) -> Array:
        """(K,) largest log odds of a fault in the train, 0 where it is less probable than none."""
        out: Array = self.believe(record).statistic.max(axis=1)
        return out


@dataclass(frozen=True)
class Watching:
    """Calibrated motors for readings every few seconds: `monitor`, sample by sample."""

    known: Known

    def believe(self, record: Record) -> Belief:
        """Probabilities of every kind of fault after each sample; causal."""
        monitor = ThermalMonitor(self.known, spacing(record))
        samples, motors = record.temperature.shape[:2]
        kind, size = np.zeros((samples, motors, len(KINDS))), np.zeros((samples, motors))
        stepped = b""
        for k, judged in enumerate(followed(monitor, record)):
            # Between blocks only a step, or a motor that starts anew, changes the result.
            steps = monitor.offsets.tobytes()
            if judged or k == 0 or steps != stepped or monitor.motors["lost"].any():
                result, stepped = monitor.kinds(), steps
            kind[k], size[k] = result
        return Belief(kind, size, hypotheses.side(kind))

    def __call__(self, record: Record) -> Array:
        """(K,) largest log odds of a fault in the train, 0 where it is less probable than none."""
        out: Array = self.believe(record).statistic.max(axis=1)
        return out


class _Blocks(NamedTuple):
    """Blocks of a fault-free run: B of M motors.

    middle_k, off_k (B, M, 3): medians of the residuals, and these relative to the other motors;
    inputs (B, M) of `struct thermal_sums`; variance (M, 3) K^2 around the medians.
    """

    middle_k: Array
    off_k: Array
    inputs: Records
    variance: Array


def _blocks(known: Known, run: Record) -> _Blocks:
    """Blocks of a run, for filters that expect no fault."""
    monitor = ThermalMonitor(known, spacing(run))
    monitor.config["imm"]["begin_per_s"] = 0.0
    blocks, spread = [], []
    for judged in followed(monitor, run):
        if judged:
            blocks.append(monitor.motors[["middle_k", "off_k", "inputs"]].copy())
            raw = monitor.motors["raw"][:, :, : monitor.block]
            spread.append((raw - blocks[-1]["middle_k"][:, :, None]) ** 2)
    middle_k, off_k, inputs = (
        np.array([block[name] for block in blocks]) for name in ("middle_k", "off_k", "inputs")
    )
    return _Blocks(middle_k, off_k, inputs, mean_of_known(np.concatenate(spread, axis=2), axis=2))


def learn(parameters: Array, runs: Sequence[Record]) -> Known:
    """Calibration for `monitor` from fault-free runs; the last was not used for `parameters`.

    The centre is the mean over all runs: a motor's offset differs from one run to another, and the
    last one alone would pass its own for the motor's. A motor without readings in the last run has
    the mean noise of the others, and no measured coverage.
    """
    dt = spacing(runs[-1])
    nothing = np.zeros((runs[-1].motors, 3))
    known = Known(parameters, nothing, np.ones_like(nothing), 1.0, _duty(parameters, runs))
    every = [_blocks(known, run) for run in runs]
    last = every[-1]
    noise = np.sqrt(last.variance)
    noise = np.where(np.isfinite(noise), noise, mean_of_known(noise))
    centre = np.nan_to_num(mean_of_known([_median(run.middle_k) for run in every]))
    beside = last.off_k - np.nan_to_num(mean_of_known([_median(run.off_k) for run in every]))
    known = _likeliest(known._replace(centre=centre, noise=noise), last.inputs, beside, dt)
    found = coverage.measure(ThermalMonitor(known, dt), beside, last.inputs)
    known = known._replace(coverage=found)
    faulty = [Watching(known).believe(run).statistic > 0.0 for run in runs]
    false_share = np.concatenate(faulty).mean(axis=0)
    return known._replace(coverage=found._replace(false_share=false_share))


def _median(values: Array) -> Array:
    """Median of the finite values along the first axis; NaN where there are none."""
    out = np.full(values.shape[1:], np.nan)
    some = np.isfinite(values).any(axis=0)
    out[some] = np.nanmedian(values[:, some], axis=0)
    return out


def _likeliest(known: Known, inputs: Records, off: Array, dt: float) -> Known:
    """`known` with the scale of the disturbances and the `own_k` likeliest on held-back blocks.

    inputs (B, M) of `struct thermal_sums`, off (B, M, 3), fault-free. One scale serves all
    disturbances: separate ones, from two hours of data, would take model error for draught, and
    then lost cooling for draught as well.
    """

    def likely(tried: Known) -> float:
        return ThermalMonitor(tried, dt).likelihood(off, inputs)

    each = [known._replace(scale=scale, own_k=own_k) for scale in SCALES for own_k in OWN_K]
    return max(each, key=likely)


def _duty(parameters: Array, runs: Sequence[Record]) -> Array:
    """(4,): see `Known`, of the fleet's mean motor."""
    mean = parameters.mean(axis=0)
    parts = []
    for run in runs:
        inputs, square = inputs_of(run), run.current_square.mean(axis=1, keepdims=True)
        start = first_readings(run).mean(axis=0, keepdims=True)
        # The ends' readings and the model give the temperatures of frame and winding.
        every = inputs._replace(
            current_square=square, speed=np.abs(run.speed), ambient=run.ambient,
            at=np.arange(len(run.speed)), step_s=run.step_s,
        )  # fmt: skip
        lumps = simulate(mean[None], every, start)[:, 0]
        speed = every.speed
        rise = np.maximum(lumps[:, model.FRAME] - run.ambient, model.LEAST_RISE_K)
        cooling = (mean[model.H_0] + mean[model.H_1] * speed) * rise
        heating = mean[model.A] * square[:, 0] * model.resistance(lumps[:, model.WINDING])
        parts.append(np.stack([speed, square[:, 0], cooling, heating], axis=1))
    return np.asarray(np.concatenate(parts).mean(axis=0))


@dataclass(frozen=True)
class ModelMethod:
    """fit_share: share of the fault-free samples that the model's parameters are fitted to."""

    fit_share: float = 0.7

    name: ClassVar[str] = "model"

    def fit(self, healthy: Record) -> Calibrated | Watching:
        """Calibrate on one fault-free record of at least some hundred samples."""
        return self.fit_runs(split(healthy, round(self.fit_share * len(healthy.at))))

    def fit_runs(self, runs: Sequence[Record]) -> Calibrated | Watching:
        """Calibrate on two or more fault-free runs: the last one is for the spread."""
        runs = [of_driven_motors(run) for run in runs]
        rest = runs[-1]
        parameters = identify(runs[:-1])
        if spacing(rest) < LONGEST_BLOCK_S:
            return Watching(learn(parameters, runs))
        residual = rest.temperature - predict(parameters, inputs_of(rest), first_readings(rest))
        return Calibrated(parameters, hypotheses.spread(residual, SNAPSHOTS.learnt))
