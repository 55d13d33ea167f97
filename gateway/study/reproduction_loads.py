"""Load estimates of section 5 of paper `adhesion` without a bus: samples in, EKF, loads out.

The paper filters at every 125 us. A slower record carries the mean voltage of its interval and
is predicted in sub-steps of 125 us, as the gateway does.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators import filters
from estimators.models import pmsm
from gateway.settings.sections import Estimator


class Filter(NamedTuple):
    """Noise settings of an EKF: name, Q per 125 us (A^2, A^2, (rad/s)^2, rad^2, Nm^2), R in A^2."""

    name: str
    Q: tuple[float, ...]
    R: float


PAPER: Final = Filter("paper's Q", (0.05, 0.05, 1e-3, 1e-4, 0.1), 0.01)
"""Section 3.2.1; the Q_0 printed there as initial covariance is the process noise."""
PRODUCT: Final = Filter(
    "product's Q", Estimator().process_noise, Estimator().current_noise_var
)  # fmt: skip


class Record(NamedTuple):
    """K evenly spaced samples of N drives.

    u (K, N, 2) mean voltage since the previous sample, V; y (K, N, 2) currents, A, both alpha-beta;
    n_sub: periods of 125 us per sample; step_a: resolution of a phase current, 0 if not rounded.
    """

    u: Array
    y: Array
    n_sub: int
    step_a: float = 0.0


class Estimates(NamedTuple):
    """Estimates after each sample: load (K, N) Nm, speed (K, N) electrical rad/s."""

    load: Array
    speed: Array


def record(volts: Array, phases: Array, n_sub: int, step_a: float, step_v: float) -> Record:
    """Record from mean voltages (K, N, 2) V and phase currents (K, N, 2 or 3) A.

    Both are rounded to their steps unless these are 0. Two phases: as in `Samples`.
    """
    volts, phases = rounded(volts, step_v), rounded(phases, step_a)
    if phases.shape[-1] == 2:
        alpha, beta = phases[..., 0], (phases[..., 0] + 2.0 * phases[..., 1]) / math.sqrt(3.0)
    else:
        alpha = (2.0 * phases[..., 0] - phases[..., 1] - phases[..., 2]) / 3.0
        beta = (phases[..., 1] - phases[..., 2]) / math.sqrt(3.0)
    return Record(volts, np.stack([alpha, beta], axis=-1), n_sub, step_a)


def rounded(values: Array, step: float) -> Array:
    """Round values to the resolution of the message; unchanged for a step of 0."""
    return values if step == 0.0 else np.asarray(np.rint(values / step) * step)


def estimate(samples: Record, belief: Filter, x_0: Array, P_0: Array) -> Estimates:
    """Run the EKF (3)-(15) of the bench motor over a record, from x_0 (N, 5) and P_0 (N, 5, 5).

    R includes step_a^2 / 12 for the rounding, as the gateway's does. Raises FloatingPointError if
    a filter diverges.
    """
    count, n = samples.y.shape[:2]
    motor = pmsm.table(pmsm.repeat(pmsm.BENCH_MOTOR, n))
    Q = np.tile(belief.Q, (n, 1))
    R = np.full((n, 2), belief.R + samples.step_a**2 / 12.0)
    drive = np.arange(n)
    n_sub, n_gap = np.full(n, samples.n_sub), np.zeros(n, dtype=np.int64)
    load, speed = np.empty((count, n)), np.empty((count, n))
    drives, settings = filters.unstarted(n), filters.settings(pmsm.SUB_STEP_S)
    drives.x, drives.P = x_0, P_0
    noise = filters.noise_records(pmsm.Noise(Q, R, np.zeros(n)))
    for k in range(count):
        rows = filters.sample_records(drive, samples.u[k], samples.y[k], n_sub, n_gap)
        filters.run(rows, motor, noise, drives, settings)
        if not drives.is_finite.all():
            raise FloatingPointError(f"{belief.name}: a filter diverged at sample {k + 1}")
        load[k], speed[k] = drives.x[:, pmsm.T_L], drives.x[:, pmsm.W_E]
    return Estimates(load, speed)


def unit_start(x: Array) -> tuple[Array, Array]:
    """Start at x (N, 5) with P = I: the paper's "low integers on diagonal"."""
    return x, np.tile(np.eye(5), (len(x), 1, 1))


def rmse(estimated: Array, true: Array) -> Array:
    """Root mean square error over time, (T, N) -> (N,)."""
    return np.asarray(np.sqrt(np.mean((estimated - true) ** 2, axis=0)))
