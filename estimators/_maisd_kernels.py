"""Compiled form of `maisd`, whose functions are the NumPy twins: all of one sample at once."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@njit(cache=True)
def take(ring: Array, seen: int, values: Array, present: Flags, mean: Array, known: Flags) -> None:
    """`maisd.push` and `maisd.average`.

    ring (s, M, P) is changed in place, `seen` samples before this one; values, present (M, P).
    Fills mean and known (M, P).
    """
    s, m, points = ring.shape
    for j in range(m):
        for p in range(points):
            ring[seen % s, j, p] = values[j, p] if present[j, p] else math.nan
            n = 0
            total = 0.0
            for k in range(s):
                value = ring[k, j, p]
                if math.isfinite(value):
                    n += 1
                    total += value
            mean[j, p] = total / n if n else 0.0
            known[j, p] = 2 * n >= s


@njit(cache=True)
def compare(mean: Array, known: Flags, spread: Array, deviation: Array) -> None:
    """`maisd.maisd` and `maisd.deviation`: fills spread (P,) and deviation (M, P)."""
    m, points = mean.shape
    ranked = np.empty(m)
    for p in range(points):
        n = 0
        total = 0.0
        for j in range(m):
            deviation[j, p] = math.nan
            if known[j, p]:
                ranked[n] = mean[j, p]
                n += 1
                total += mean[j, p]
        spread[p] = math.nan
        if n < 2:
            continue
        centre = total / n
        square = 0.0
        # Ranked once: the others' middle ones are found beside the motor's own place.
        ranked[:n] = np.sort(ranked[:n])
        low, high = (n - 2) // 2, (n - 1) // 2
        for j in range(m):
            if not known[j, p]:
                continue
            own = mean[j, p]
            square += (own - centre) ** 2
            place = np.searchsorted(ranked[:n], own)
            middle = ranked[low + (low >= place)] + ranked[high + (high >= place)]
            deviation[j, p] = own - 0.5 * middle
        spread[p] = math.sqrt(square / n)
