"""An extended Kalman filter of every point, with 3 x 3 matrices: oracle of `rivals/ekf.c`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_NUDGE = 1e-4
"""Of the logarithm of the loss, for the derivative by it."""
_FACTOR = 2.0
"""Logarithm of the factor within which the coefficients of a machine stay."""


def gap(
    loss: float, heat: Array, share: float, speed_square: Array, air: Array, step_s: float
) -> tuple[float, float, float]:
    """Decay, heat's and air's part over steps of constant heat (n,) A^2 and air (n,) degC.

    Exact for the first-order model: the last step's heat has decayed for no step.
    """
    keep = math.exp(-loss * step_s)
    decay, warmed, aired = 1.0, 0.0, 0.0
    for j in range(len(heat)):
        decay *= keep
        warmed = warmed * keep + heat[j] + share * speed_square[j]
        aired = aired * keep + air[j]
    return decay, warmed * (1.0 - keep) / loss, aired * (1.0 - keep)


def innovations(
    reading: Array, at: Ints, square: Array, speed_square: Array, air: Array, step_s: float,
    model: Array, step: float, doubt: float, out: Array,
) -> None:  # fmt: skip
    """Fill out (K, N): innovations over their sigma, 0 where there is no reading.

    reading (K, N) degC; at (K,): steps; square (L, M) A^2, three points a motor; speed_square, air
    (L,); model (7, N): gain, loss, speed_share, offset, unrest, noise, usual of `ekf.Lumped`; step:
    variance of the logarithms of gain and loss per sample; doubt: their sigma at the start.
    """
    P, A = np.empty((3, 3)), np.eye(3)
    x, low, high, gains = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for n in range(reading.shape[1]):
        gain, loss, share, offset, unrest, noise, usual = model[:, n]
        x[0], x[1], x[2] = usual - offset, math.log(gain), math.log(loss)
        low[:], high[:] = x - _FACTOR, x + _FACTOR
        P[:] = 0.0
        P[0, 0], P[1, 1], P[2, 2] = 100.0, doubt * doubt, doubt * doubt
        last = at[0]
        for k in range(len(at)):
            if at[k] > last:
                first, end = last + 1, at[k] + 1
                heat, fast = square[first:end, n // 3], speed_square[first:end]
                gain, loss = math.exp(x[1]), math.exp(x[2])
                decay, warmed, aired = gap(loss, heat, share, fast, air[first:end], step_s)
                T = decay * x[0] + gain * warmed + aired
                more, hotter, fresher = gap(
                    loss * (1.0 + _NUDGE), heat, share, fast, air[first:end], step_s
                )
                A[0, 0], A[0, 1] = decay, gain * warmed
                A[0, 2] = (more * x[0] + gain * hotter + fresher - T) / _NUDGE
                x[0] = T
                P = A @ P @ A.T
                P[0, 0] += unrest * (1.0 - decay * decay)
                P[1, 1] += step
                P[2, 2] += step
                last = at[k]
            out[k, n] = 0.0
            if not math.isfinite(reading[k, n]):
                continue
            s = P[0, 0] + noise
            nu = reading[k, n] - offset - x[0]
            out[k, n] = nu / math.sqrt(s)
            gains[:] = P[:, 0] / s
            row = P[0].copy()
            for i in range(3):
                x[i] += gains[i] * nu
                for j in range(3):
                    P[i, j] -= gains[i] * row[j]
            for i in range(1, 3):
                x[i] = min(max(x[i], low[i]), high[i])
