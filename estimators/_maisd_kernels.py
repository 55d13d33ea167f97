"""Compiled form of `maisd`, whose functions are the NumPy twins: all of one sample at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import lean

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@lean
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
                # Ranked once: the others' middle ones are found beside the motor's own place.
                place = n
                while place > 0 and ranked[place - 1] > mean[j, p]:
                    ranked[place] = ranked[place - 1]
                    place -= 1
                ranked[place] = mean[j, p]
                n += 1
                total += mean[j, p]
        spread[p] = math.nan
        if n < 2:
            continue
        centre = total / n
        square = 0.0
        low, high = (n - 2) // 2, (n - 1) // 2
        for j in range(m):
            if not known[j, p]:
                continue
            own = mean[j, p]
            square += (own - centre) ** 2
            place = 0
            while ranked[place] < own:
                place += 1
            middle = ranked[low + (low >= place)] + ranked[high + (high >= place)]
            deviation[j, p] = own - 0.5 * middle
        spread[p] = math.sqrt(square / n)
