"""The sigma-mixed unscented Kalman filter: paper `thermal`, (1), (8), (19)-(21), Algorithm 1.

One filter per motor, its states the three points' temperatures. Between two samples every point is
one lump, (1) corrected: Joule heat is that of the current, not of its change; the loss is
-xi (T - T_out); the time step multiplies both,

    dT/dt = g I^2 - xi (T - T_out),     integrated exactly from sample to sample.

After the prediction the sigma points of all three coupled points, each less its usual distance from
their mean, are pooled, and a mixture is fitted to the pool (EM). Its mean is the mixed state, the
common part of the prior. As printed, (21) weights every component alike in this mean; `weighted`
uses the mixture's own mean.

The filter itself and its corrections are in `sigma_mixed.c`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from _traction_core import lib

from dbc import records
from dbc.arrays import Array
from dbc.records import Records, pointer
from estimators.thermal.record import Record, fading

SIGMA_MIXED_CONFIG: Final = records.SIGMA_MIXED_CONFIG
SIGMA_MIXED_SAMPLE: Final = records.SIGMA_MIXED_SAMPLE
KAPPA: Final = 0.0
"""n + kappa = 3: the sigma points match the kurtosis of a Gaussian."""
MIXING: Final = 0.2
READING_VAR: Final = 0.1
"""K^2: noise and resolution of a temperature."""
LOSSES: Final = 1.0 / np.geomspace(200.0, 7200.0, 15)
"""Values of xi that are tried, 1/s."""


class Lumps(NamedTuple):
    """Parameters of each motor and point, all (M, 3) except `apart`.

    gain: g over xi, K/A^2; loss: xi, 1/s; offset: K; q, r: variances K^2 of the model's error from
    sample to sample and of a reading; apart (3,): usual distance of a point from the three's mean.
    """

    gain: Array
    loss: Array
    offset: Array
    q: Array
    r: Array
    apart: Array


class Estimates(NamedTuple):
    """state (K, M, 3) degC after the update, mixed (K, M): the mixed state."""

    state: Array
    mixed: Array


def lumps(record: Record) -> Lumps:
    """Least squares on a fault-free record: best of `LOSSES`, gain and offset for each point."""
    motors = record.motors
    shape = (motors, 3)
    gain, loss, offset, q, r = (np.zeros(shape) for _ in range(5))
    for m in range(motors):
        for p in range(3):
            y = record.temperature[:, m, p]
            seen = np.isfinite(y)
            best = np.inf
            for xi in LOSSES.tolist():
                heat, air = _forced(record, m, xi)
                rows = np.stack([heat, np.ones(len(heat))], axis=1)[seen]
                (a, b), *_ = np.linalg.lstsq(rows, (y - air)[seen], rcond=None)
                error = y[seen] - air[seen] - rows @ np.array([a, b])
                if float(error @ error) < best:
                    best = float(error @ error)
                    gain[m, p], loss[m, p], offset[m, p] = a, xi, b
                    # If samples are hours apart, the model's error is white, too: only the
                    # known noise of a sensor separates the two.
                    total = max(float(np.var(error)), 2.0 * READING_VAR)
                    r[m, p], q[m, p] = READING_VAR, total - READING_VAR
    level = np.nanmean(record.temperature, axis=(0, 1))
    return Lumps(gain, loss, offset, q, r, level - level.mean())


def _forced(record: Record, m: int, xi: float) -> tuple[Array, Array]:
    """(K,) averages of I^2 and of the ambient that a lump with loss xi remembers."""
    share = 1.0 - float(np.exp(-xi * record.step_s))
    heat = fading(record.current_square[:, m], share)[record.at]
    return heat, fading(record.ambient, share)[record.at]


@dataclass(frozen=True)
class SigmaMixedFilter:
    """Algorithm 1, with deviations from it as options.

    weighted: the mixture's mean in place of (21); mixing: share of the common part that the mixture
    gives (0 is the plain UKF).
    """

    weighted: bool = False
    mixing: float = MIXING

    def run(self, record: Record, known: Lumps, drift: Array | None = None) -> Estimates:
        """Algorithm 1 over a record; drift (M, 3) K/s of the degradation, in the prediction.

        Causal. Without a reading the filter only predicts.
        """
        k, m, _ = record.temperature.shape
        settled = np.empty((k, m, 3))
        for i in range(m):
            for p in range(3):
                heat, air = _forced(record, i, float(known.loss[i, p]))
                settled[:, i, p] = known.gain[i, p] * heat + air + known.offset[i, p]
        gap = np.diff(record.at, prepend=record.at[0]) * record.step_s
        keep = np.exp(-known.loss * gap[:, None, None])
        config = self.configs(known, np.zeros((m, 3)) if drift is None else drift)
        return estimate(config, record.temperature, settled, keep, gap)

    def configs(self, known: Lumps, drift: Array) -> Records:
        """(M,) of `struct sigma_mixed_config`; drift (M, 3) K/s."""
        out = np.zeros(len(drift), SIGMA_MIXED_CONFIG)
        out["drift"], out["q"], out["r"], out["apart"] = drift, known.q, known.r, known.apart
        out["kappa"], out["mixing"], out["weighted"] = KAPPA, self.mixing, self.weighted
        return out


def estimate(
    configs: Records, y: Array, settled: Array, keep: Array, gap: Array
) -> Estimates:  # fmt: skip
    """Algorithm 1 for motors (M,) from their samples: y, settled, keep (K, M, 3), gap (K,) s.

    See `struct sigma_mixed_sample`.
    """
    samples, motors, points = y.shape
    state, mixed = np.empty((motors, samples, points)), np.empty((motors, samples))
    for m in range(motors):
        given = np.empty(samples, SIGMA_MIXED_SAMPLE)
        given["y"], given["settled"], given["keep"] = y[:, m], settled[:, m], keep[:, m]
        given["gap"] = gap
        lib.sigma_mixed_run(
            pointer("struct sigma_mixed_config", configs[m : m + 1]),
            pointer("struct sigma_mixed_sample", given), samples, pointer("double", state[m]),
            pointer("double", mixed[m]),
        )  # fmt: skip
    return Estimates(state.transpose(1, 0, 2).copy(), mixed.T.copy())
