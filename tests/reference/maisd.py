"""MAISD in NumPy, which `estimators/maisd.c` is compared with: paper `thermal`, eq. (29)-(31).

Corrections: (29) as printed averages k .. k+s-1 and so looks ahead; here the window ends at
k. (31) uses one index for motors and for their count; it is the spread of the m motors
around their mean. A constant difference between healthy motors (sensor, cooling position)
would be part of it, so each motor is centred on its fault-free data first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class MovingAverage(NamedTuple):
    """Causal moving average of M motors x P points; see `start`.

    ring: (s, M, P) the last s values, NaN where a value was missing; seen: samples pushed.
    """

    ring: Array
    seen: int


def start(window: int, motors: int, points: int) -> MovingAverage:
    """An empty window of `window` samples."""
    return MovingAverage(np.full((window, motors, points), np.nan), 0)


def push(state: MovingAverage, values: Array, present: NDArray[np.bool_]) -> MovingAverage:
    """Add one sample (M, P); entries not `present` are left out of the averages."""
    ring = state.ring.copy()
    ring[state.seen % len(ring)] = np.where(present, values, np.nan)
    return MovingAverage(ring, state.seen + 1)


def average(state: MovingAverage) -> tuple[Array, NDArray[np.bool_]]:
    """Window means (M, P) and whether each is known: at least half a full window present."""
    present = np.isfinite(state.ring)
    n = present.sum(axis=0)
    total = np.where(present, state.ring, 0.0).sum(axis=0)
    known = 2 * n >= len(state.ring)
    return np.divide(total, n, out=np.zeros_like(total), where=n > 0), known


def maisd(mean: Array, known: NDArray[np.bool_]) -> Array:
    """(31) per point: standard deviation over the known motors, (P,); NaN with fewer than 2.

    mean: (M, P) centred window averages, K.
    """
    n = known.sum(axis=0)
    safe = np.where(known, mean, 0.0)
    centre = np.divide(safe.sum(axis=0), n, out=np.zeros(mean.shape[1]), where=n > 0)
    square = np.where(known, (mean - centre) ** 2, 0.0).sum(axis=0)
    spread: Array = np.sqrt(np.divide(square, n, out=np.full(mean.shape[1], np.nan), where=n >= 2))
    return spread


def deviation(mean: Array, known: NDArray[np.bool_]) -> Array:
    """Each motor against the median of the *other* known motors, (M, P); NaN if none.

    The plain mean is pulled by the fault itself; the median of the others is not. An even number of
    others has two medians, and what lies between: the nearest one counts.
    """
    out = np.full(mean.shape, np.nan)
    for p in range(mean.shape[1]):
        motors = np.flatnonzero(known[:, p]).tolist()
        ranked = sorted((float(mean[j, p]), j) for j in motors)
        for j in motors:
            others = [value for value, k in ranked if k != j]
            if others:
                middle = len(others) // 2
                even = len(others) % 2 == 0
                low = others[middle - 1] if even else others[middle]
                out[j, p] = mean[j, p] - np.clip(mean[j, p], low, others[middle])
    return out
