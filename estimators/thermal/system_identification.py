"""Parameters of `model` from fault-free runs, by output error.

The whole run is simulated and compared with the readings. (One-step prediction errors are biased:
at 1 Hz the noise is ten times the change per step.) The motors of a fleet are alike, so the mean
motor is found first, by Levenberg-Marquardt. Each motor's own parameters follow from the mean
motor's sensitivities in a few Gauss-Newton steps. The search is for logarithms of rates, so that
rates stay positive, and near typical ones unless the data contradict. The core's temperature at the
beginning of a run is unknown, too: it is not measured, and a wrong guess makes an hour of the model
wrong, which bends all rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.model import (
    COUNT,
    E_1,
    E_2,
    F_D,
    F_N,
    H_1,
    RATES,
    TYPICAL,
    A,
    Inputs,
    inputs_of,
    predict,
)
from estimators.thermal.record import Record

PRIOR_SIGMA: Final = np.array([0.5] * RATES + [5.0] * 3)
"""Prior of the logarithm of a rate around the typical one, and of an offset, K."""
OWN_SIGMA: Final = np.array([0.15] * RATES + [2.0] * 3)
"""The same for a motor around the mean motor."""
CORE_SIGMA: Final = 15.0
"""Prior, K, of a run's first core temperature around that of `model.initial_state`."""
NOISE_K: Final = 2.0
"""Standard deviation of the residuals, taken as independent from sample to sample."""
MOST_SAMPLES: Final = 400
DIFFERENCE: Final = 1e-3
ITERATIONS: Final = 30
MOST_STEP: Final = 1.0
"""Largest step of one iteration, in prior standard deviations."""
OWN_STEPS: Final = 8


TYPICAL_SQUARE, TYPICAL_SPEED = 1.2e4, 200.0
"""A^2 and rad/s: mean duty of the motor that `model.TYPICAL` describes."""
SCALED_SIGMA: Final = np.array([1.5] * RATES + [2.0] * 3)
"""As `PRIOR_SIGMA`, around rates that were only scaled to a motor's size."""
PACES: Final = (1.0, 2.0, 4.0, 8.0)
"""How many times quicker a smaller motor may warm."""


def scaled(runs: Sequence[Record]) -> Array:
    """(18,) typical rates for motors of another size, for `identify`: the likeliest of a few.

    Losses are assumed to warm each motor at its own mean duty as much as the typical one at its.
    """
    square = max(float(np.mean([run.current_square.mean() for run in runs])), 1e-9)
    speed = max(float(np.mean([np.abs(run.speed).mean() for run in runs])), 1e-9)
    by_square, by_speed = TYPICAL_SQUARE / square, TYPICAL_SPEED / speed
    same = TYPICAL.copy()
    same[A] *= by_square
    same[[E_1, F_D, F_N, H_1]] *= by_speed
    same[E_2] *= by_speed**2
    fleet = [_thinned(run).mean() for run in runs]
    found = []
    for pace in PACES:
        typical = same.copy()
        typical[:RATES] *= pace
        theta = _mean_motor(fleet, typical, SCALED_SIGMA)
        sigma = np.concatenate([SCALED_SIGMA, np.full(len(runs), CORE_SIGMA)])
        found.append((_errors(theta, fleet, sigma, typical)[1], typical))
    return min(found, key=lambda pair: pair[0])[1]


def identify(
    runs: Sequence[Record], typical: Array = TYPICAL, spread: Array = PRIOR_SIGMA
) -> Array:
    """(M, 18) parameters of the motors from fault-free runs (at least one) of all of them.

    typical (18,): start of the search and mean of the prior; spread (18,): standard deviations of
    the prior, of the logarithms of rates and of offsets, K.
    Raises ValueError unless every motor has a sample with all temperatures.
    """
    inputs = [_thinned(run) for run in runs]
    complete = [np.isfinite(run.readings).all(axis=2).any(axis=0) for run in inputs]
    if not np.any(complete, axis=0).all():
        raise ValueError("a motor has no sample with all temperatures in any run")
    fleet = [run.mean() for run in inputs]
    theta = _mean_motor(fleet, typical, spread)
    slopes = _slopes(theta, fleet, typical)[:, :COUNT]
    return _own(theta, slopes, inputs, typical)


class _Run(NamedTuple):
    """Inputs, readings (K, M, 3), and those at the beginning (M, 3)."""

    inputs: Inputs
    readings: Array
    start: Array

    def mean(self) -> _Run:
        """Mean over the motors, as one motor."""
        square = self.inputs.current_square.mean(axis=1, keepdims=True)
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(self.readings)
            total = np.where(seen, self.readings, 0.0).sum(axis=1, keepdims=True)
            readings = total / seen.sum(axis=1, keepdims=True)
        start = self.start.mean(axis=0, keepdims=True)
        return _Run(self.inputs._replace(current_square=square), readings, start)

    def errors(self, parameters: Array, core: float) -> Array:
        """(K, M, 3) readings less the model's; core: as in `model.predict`, of all motors."""
        warmer = np.full(len(parameters), core)
        return self.readings - predict(parameters, self.inputs, self.start, core=warmer)


def _thinned(run: Record) -> _Run:
    """At most MOST_SAMPLES samples of a run."""
    every = -(-len(run.at) // MOST_SAMPLES)
    part = slice(every - 1, None, every)
    thin = run._replace(at=run.at[part], temperature=run.temperature[part])
    return _Run(inputs_of(thin), thin.temperature, first_readings(run))


def first_readings(run: Record) -> Array:
    """(M, 3) degC: each sensor's first reading, the mean of all first ones where it has none."""
    out = np.full(run.temperature.shape[1:], np.nan)
    for m, p in np.ndindex(*out.shape):
        seen = np.flatnonzero(np.isfinite(run.temperature[:, m, p]))
        out[m, p] = run.temperature[seen[0], m, p] if len(seen) else np.nan
    known = np.isfinite(out)
    return np.where(known, out, float(out[known].mean()) if known.any() else run.ambient[0])


def _plain(theta: Array, typical: Array) -> Array:
    """(..., 18) rates and offsets from logarithms of rates, and offsets."""
    out = theta.copy()
    out[..., :RATES] = typical[:RATES] * np.exp(theta[..., :RATES])
    return out


def _mean_motor(runs: Sequence[_Run], typical: Array, spread: Array) -> Array:
    """(18 + R,) search variables of the mean motor, and K of its core at the start of R runs."""
    theta, damping = np.zeros(COUNT + len(runs)), 1.0
    sigma = np.concatenate([spread, np.full(len(runs), CORE_SIGMA)])
    error, cost = _errors(theta, runs, sigma, typical)
    for _ in range(ITERATIONS):
        step = _solve(_slopes(theta, runs, typical), error, theta, sigma, damping)
        tried = theta + np.clip(step, -MOST_STEP * sigma, MOST_STEP * sigma)
        tried_error, tried_cost = _errors(tried, runs, sigma, typical)
        if tried_cost < cost:
            done = cost - tried_cost < 1e-4 * cost
            theta, error, cost, damping = tried, tried_error, tried_cost, 0.3 * damping
            if done:
                break
        else:
            damping *= 10.0
    return theta


def _errors(
    theta: Array, runs: Sequence[_Run], sigma: Array, typical: Array
) -> tuple[Array, float]:
    """Readings less the model's, flat, 0 where there is none; and the penalised sum of squares."""
    plain = _plain(theta[:COUNT], typical)[None]
    each = zip(runs, theta[COUNT:].tolist(), strict=True)
    error = np.concatenate([np.nan_to_num(run.errors(plain, core)).ravel() for run, core in each])
    cost = float(np.sum((error / NOISE_K) ** 2) + np.sum((theta / sigma) ** 2))
    return error, cost if np.isfinite(cost) else np.inf


def _slopes(theta: Array, runs: Sequence[_Run], typical: Array) -> Array:
    """(3 K of all runs, 18 + R) derivatives of the readings by the search variables."""
    parts = []
    for r, run in enumerate(runs):
        own, core = _sensitivities(theta[:COUNT], float(theta[COUNT + r]), run, typical)
        cores = np.zeros((len(own), len(runs)))
        cores[:, r] = core
        parts.append(np.hstack([own, cores]))
    return np.concatenate(parts)


def _sensitivities(theta: Array, core: float, run: _Run, typical: Array) -> tuple[Array, Array]:
    """Derivatives by difference, all perturbed motors in one run: (3 K, 18); by the core (3 K,)."""
    tried = np.tile(theta, (COUNT + 2, 1))
    tried[1 : COUNT + 1] += DIFFERENCE * np.eye(COUNT)
    warmer = np.full(COUNT + 2, core)
    warmer[-1] += 1.0
    starts = np.tile(run.start, (COUNT + 2, 1))
    out = predict(_plain(tried, typical), run.inputs, starts, core=warmer)
    slopes = (out[:, 1:-1] - out[:, :1]) / DIFFERENCE
    by_core = out[:, -1] - out[:, 0]
    return slopes.transpose(0, 2, 1).reshape(-1, COUNT), by_core.ravel()


def _solve(slopes: Array, error: Array, around: Array, sigma: Array, damping: float) -> Array:
    """Step of the penalised least squares; `around`: distance from the prior's mean already."""
    normal = slopes.T @ slopes / NOISE_K**2
    weight = 1.0 / sigma**2
    right = slopes.T @ error / NOISE_K**2 - weight * around
    return np.asarray(np.linalg.solve(normal + np.diag(weight * (1.0 + damping)), right))


def _own(found: Array, slopes: Array, runs: Sequence[_Run], typical: Array) -> Array:
    """(M, 18) parameters of every motor around the mean motor's search variables `found`."""
    mean, cores = found[:COUNT], found[COUNT:].tolist()
    theta = np.tile(mean, (runs[0].readings.shape[1], 1))
    for _ in range(OWN_STEPS):
        each = zip(runs, cores, strict=True)
        errors = [run.errors(_plain(theta, typical), core) for run, core in each]
        for m in range(len(theta)):
            error = np.concatenate([e[:, m].ravel() for e in errors])
            seen = np.isfinite(error)
            theta[m] += _solve(slopes[seen], error[seen], theta[m] - mean, OWN_SIGMA, 0.0)
    return _plain(theta, typical)
