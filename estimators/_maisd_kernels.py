"""Compiled form of `maisd`, whose functions are the NumPy twins: all of one sample at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import lean

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


@lean
def take(
    ring: Array, seen: int, values: Array, present: Flags, mean: Array, number: Ints, known: Flags
) -> None:
    """`maisd.push` and `maisd.average`.

    ring (s, M, P) is changed in place, `seen` samples before this one; values, present (M, P).
    Fills mean, number (of values that are there) and known (M, P).
    """
    s, m, points = ring.shape
    for j in range(m):
        for p in range(points):
            ring[seen % s, j, p] = values[j, p] if present[j, p] else math.nan
            mean[j, p] = 0.0
            number[j, p] = 0
    # As it lies in memory: motor by motor, a window of 1,000 motors would not fit the cache.
    for k in range(s):
        for j in range(m):
            for p in range(points):
                value = ring[k, j, p]
                if math.isfinite(value):
                    mean[j, p] += value
                    number[j, p] += 1
    for j in range(m):
        for p in range(points):
            n = number[j, p]
            mean[j, p] = mean[j, p] / n if n else 0.0
            known[j, p] = 2 * n >= s


@lean
def _rank(values: Array, n: int) -> None:
    """Sort the first n in place, by Shell's method: it needs no room, and for 1,000 few steps."""
    step = 1
    while step < n // 3:
        step = 3 * step + 1
    while step > 0:
        for k in range(step, n):
            value, place = values[k], k
            while place >= step and values[place - step] > value:
                values[place] = values[place - step]
                place -= step
            values[place] = value
        step //= 3


@lean
def compare(mean: Array, known: Flags, ranked: Array, spread: Array, deviation: Array) -> None:
    """`maisd.maisd` and `maisd.deviation`: fills spread (P,) and deviation (M, P).

    ranked (M,): room.
    """
    m, points = mean.shape
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
        _rank(ranked, n)
        centre = total / n
        square = 0.0
        low, high = (n - 2) // 2, (n - 1) // 2
        for j in range(m):
            if not known[j, p]:
                continue
            own = mean[j, p]
            square += (own - centre) ** 2
            # The others' rank is one more from the motor's own place on.
            middle = ranked[low + (ranked[low] >= own)] + ranked[high + (ranked[high] >= own)]
            deviation[j, p] = own - 0.5 * middle
        spread[p] = math.sqrt(square / n)
