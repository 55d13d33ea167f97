"""Parameters of `heat` from fault-free runs, by output error.

The whole run is simulated and compared with the readings. (One-step prediction errors are biased:
at 1 Hz the noise is ten times the change per step.) Motors of a fleet are alike: the mean motor is
found first, by Levenberg-Marquardt; every motor's own then from the mean motor's sensitivities, in
two Gauss-Newton steps. Rates are sought as logarithms, so they stay positive, near what is typical
unless the data say otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.thermal.heat import COUNT, RATES, TYPICAL, Drive, drive, predict
from estimators.thermal.record import Record

Array = NDArray[np.float64]

PRIOR_SIGMA: Final = np.array([1.0] * RATES + [5.0] * 3)
"""Of the logarithm of a rate around the typical one, and K of an offset."""
OWN_SIGMA: Final = np.array([0.15] * RATES + [2.0] * 3)
"""The same of a motor around the mean motor."""
NOISE_K: Final = 1.0
"""What the model leaves unexplained, independent from sample to sample."""
MOST_SAMPLES: Final = 400
DIFFERENCE: Final = 1e-3
ITERATIONS: Final = 12
OWN_STEPS: Final = 2


def identify(runs: Sequence[Record]) -> Array:
    """(M, 16) parameters of the motors from fault-free runs (at least one) of all of them.

    Raises ValueError if there is no reading.
    """
    inputs = [_thinned(run) for run in runs]
    if not any(np.isfinite(run.readings).all(axis=(1, 2)).any() for run in inputs):
        raise ValueError("no sample with all temperatures in any run")
    fleet = [run.mean() for run in inputs]
    mean = _mean_motor(fleet)
    slopes = np.concatenate([_sensitivities(mean, run) for run in fleet])
    return _own(mean, slopes, inputs)


class _Run(NamedTuple):
    """Inputs, readings (K, M, 3), and those at the beginning (M, 3)."""

    inputs: Drive
    readings: Array
    start: Array

    def mean(self) -> _Run:
        """Of the motors, as one motor."""
        square = self.inputs.current_square.mean(axis=1, keepdims=True)
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(self.readings)
            total = np.where(seen, self.readings, 0.0).sum(axis=1, keepdims=True)
            readings = total / seen.sum(axis=1, keepdims=True)
        start = self.start.mean(axis=0, keepdims=True)
        return _Run(self.inputs._replace(current_square=square), readings, start)

    def errors(self, parameters: Array) -> Array:
        """(K, M, 3) readings less the model's."""
        return self.readings - predict(parameters, self.inputs, self.start)


def _thinned(run: Record) -> _Run:
    """At most MOST_SAMPLES samples of a run."""
    every = -(-len(run.at) // MOST_SAMPLES)
    part = slice(every - 1, None, every)
    thin = run._replace(at=run.at[part], temperature=run.temperature[part])
    return _Run(drive(thin), thin.temperature, first_readings(run))


def first_readings(run: Record) -> Array:
    """(M, 3) degC: each sensor's first reading, the mean of all first ones where it has none."""
    out = np.full(run.temperature.shape[1:], np.nan)
    for m, p in np.ndindex(*out.shape):
        seen = np.flatnonzero(np.isfinite(run.temperature[:, m, p]))
        out[m, p] = run.temperature[seen[0], m, p] if len(seen) else np.nan
    known = np.isfinite(out)
    return np.where(known, out, float(out[known].mean()) if known.any() else run.ambient[0])


def _plain(theta: Array) -> Array:
    """(..., 16) rates and offsets from logarithms of rates, and offsets."""
    out = theta.copy()
    out[..., :RATES] = TYPICAL[:RATES] * np.exp(theta[..., :RATES])
    return out


def _mean_motor(runs: Sequence[_Run]) -> Array:
    """(16,) search variables of the mean motor."""
    theta, damping = np.zeros(COUNT), 1.0
    error, cost = _errors(theta, runs)
    for _ in range(ITERATIONS):
        slopes = np.concatenate([_sensitivities(theta, run) for run in runs])
        step = _solve(slopes, error, theta, PRIOR_SIGMA, damping)
        tried = theta + np.clip(step, -1.0, 1.0)
        tried_error, tried_cost = _errors(tried, runs)
        if tried_cost < cost:
            done = cost - tried_cost < 1e-4 * cost
            theta, error, cost, damping = tried, tried_error, tried_cost, 0.3 * damping
            if done:
                break
        else:
            damping *= 10.0
    return theta


def _errors(theta: Array, runs: Sequence[_Run]) -> tuple[Array, float]:
    """Readings less the model's, flat, 0 where there is none; and the penalised sum of squares."""
    parts = [np.nan_to_num(run.errors(_plain(theta)[None])).ravel() for run in runs]
    error = np.concatenate(parts)
    cost = float(np.sum((error / NOISE_K) ** 2) + np.sum((theta / PRIOR_SIGMA) ** 2))
    return error, cost if np.isfinite(cost) else np.inf


def _sensitivities(theta: Array, run: _Run) -> Array:
    """(3 K, 16) derivatives of the readings by differences: all perturbed motors in one run."""
    tried = np.tile(theta, (COUNT + 1, 1))
    tried[1:] += DIFFERENCE * np.eye(COUNT)
    out = predict(_plain(tried), run.inputs, np.tile(run.start, (COUNT + 1, 1)))
    slopes = (out[:, 1:] - out[:, :1]) / DIFFERENCE
    return slopes.transpose(0, 2, 1).reshape(-1, COUNT)


def _solve(slopes: Array, error: Array, around: Array, sigma: Array, damping: float) -> Array:
    """Step of the penalised least squares; `around`: distance from the prior's mean already."""
    normal = slopes.T @ slopes / NOISE_K**2
    weight = 1.0 / sigma**2
    right = slopes.T @ error / NOISE_K**2 - weight * around
    return np.asarray(np.linalg.solve(normal + np.diag(weight * (1.0 + damping)), right))


def _own(mean: Array, slopes: Array, runs: Sequence[_Run]) -> Array:
    """(M, 16) parameters of every motor around the mean motor's search variables."""
    theta = np.tile(mean, (runs[0].readings.shape[1], 1))
    for _ in range(OWN_STEPS):
        errors = [run.errors(_plain(theta)) for run in runs]
        for m in range(len(theta)):
            error = np.concatenate([e[:, m].ravel() for e in errors])
            seen = np.isfinite(error)
            theta[m] += _solve(slopes[seen], error[seen], theta[m] - mean, OWN_SIGMA, 0.0)
    return _plain(theta)
