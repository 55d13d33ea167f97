"""Compiled loop of `steps`: sensor by sensor, sample by sample."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ENOUGH = 3
"""Readings that a median needs."""


@njit(cache=True)
def _median(x: Array, first: int, end: int) -> float:
    """Of the readings in x[first:end]; NaN of fewer than `_ENOUGH`."""
    values = np.empty(end - first)
    n = 0
    for k in range(first, end):
        if math.isfinite(x[k]):
            values[n] = x[k]
            n += 1
    return float(np.median(values[:n])) if n >= _ENOUGH else math.nan


@njit(cache=True)
def follow(
    x: Array, counts: NDArray[np.int64], step: float, back: float, follows: float, out: Array
) -> None:
    """Fill out (K, S) K: offsets of S sensors with residuals x (K, S).

    counts: samples before, after, and until a step has settled; step, back: see `steps`; follows:
    K per sample that the level of a sensor without offset may change by.
    """
    before, after, settled = counts
    for s in range(x.shape[1]):
        own = np.ascontiguousarray(x[:, s])
        off, level, home = 0.0, math.nan, math.nan
        # Sample at which a step that has not settled yet was seen; samples since `level` was.
        seen, old = -1, 0
        for k in range(before + after, x.shape[0]):
            if seen < 0:
                now = _median(own, k + 1 - after - before, k + 1 - after)
                known = math.isfinite(now)
                old = 0 if known else old + 1
                # Over a short hole the level is what it was; over a long one anything may warm.
                level = now if known or old > settled else level
                if off == 0.0 and math.isfinite(level):
                    home = level if math.isnan(home) else home
                    home += min(max(level - home, -follows), follows)
                elif abs(level - home) < back:
                    # It was two bursts in a row, or has crept back.
                    off = 0.0
                # A median that is no number is not far from anything.
                if abs(_median(own, k + 1 - after, k + 1) - level) > step:
                    seen = k
            elif k >= seen + settled:
                moved = _median(own, k + 1 - before, k + 1) - level
                if abs(moved) > 0.8 * step:
                    off += moved
                    off = off if abs(off) >= back else 0.0
                if math.isfinite(moved):
                    seen = -1
            out[k, s] = off
