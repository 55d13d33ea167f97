"""Step detector in NumPy, which `estimators/thermal/step_detector.c` is compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFF, LEVEL, HOME, SINCE, OLD = range(5)
"""A sensor's state: offset K, level and undisturbed level K, samples since a step was seen that has
not settled yet (-1 none), samples since `LEVEL` was seen."""
STATE = 5
_ENOUGH = 3
"""Readings that a median needs."""


def _median(x: Array, first: int, end: int) -> float:
    """Of the readings in x[first:end]; NaN of fewer than `_ENOUGH`."""
    values = np.empty(end - first)
    n = 0
    for k in range(first, end):
        if math.isfinite(x[k]):
            values[n] = x[k]
            n += 1
    return float(np.median(values[:n])) if n >= _ENOUGH else math.nan


def _trend(x: Array, first: int, end: int) -> tuple[float, float, float]:
    """Of the line through the medians of the halves of x[first:end]: place, value there, slope."""
    middle = (first + end) // 2
    one, two = _median(x, first, middle), _median(x, middle, end)
    return 0.5 * (middle + end - 1), two, (two - one) / (0.5 * (end - first))


def _jump(x: Array, before: int, after: int, level: float) -> float:
    """K that x jumps by in [before, before + after): what came then less what was to be expected.

    Expected is what would have come of the trend before, or of the trend after if that explains
    more: a winding that begins to warm by 0.1 K/s bends, it does not jump. Over a hole: the level.
    """
    end = before + after
    at = before + 0.5 * (after - 1)
    place, value, slope = _trend(x, end, len(x))
    now = value + slope * (at - place)
    was_at, was, was_slope = _trend(x, 0, before)
    near = _median(x, before - after, before)
    if not (math.isfinite(was + was_slope) and math.isfinite(near)):
        return now - level
    straight = now - (was + was_slope * (at - was_at))
    bent = now - (near + slope * (at - (before - 0.5 * (after + 1))))
    return straight if abs(straight) < abs(bent) else bent


def others_jump(windows: Sequence[Array], m: int, before: int, after: int) -> float:
    """Median jump of the sensors beside the m-th; 0 if none shows one."""
    found = [_jump(x, before, after, math.nan) for k, x in enumerate(windows) if k != m]
    found = [moved for moved in found if math.isfinite(moved)]
    return float(np.median(found)) if found else 0.0


def all_jump(points: Sequence[Sequence[Array]], before: int, after: int, step: float) -> bool:
    """Whether the middle motor jumps at all points, at least two, in one direction.

    points: the motors' windows by point; each jump is beyond 0.8 of `step`.
    """
    signs = []
    for windows in points:
        found = [_jump(x, before, after, math.nan) for x in windows]
        found = [moved for moved in found if math.isfinite(moved)]
        if found:
            middle = float(np.median(found))
            signs.append(math.copysign(1.0, middle) if abs(middle) > 0.8 * step else 0.0)
    return len(signs) > 1 and abs(sum(signs)) == len(signs)


def start(state: Array) -> None:
    """A sensor that nothing is known of, state (5,) in place."""
    state[OFF], state[LEVEL], state[HOME], state[SINCE], state[OLD] = 0.0, math.nan, math.nan, -1, 0


def one(
    x: Array,
    state: Array,
    before: int,
    after: int,
    step: float,
    back: float,
    follows: float,
    others: float = 0.0,
) -> None:
    """One more sample: x, the latest before + after + settled of a sensor's residuals; state (5,).

    step, back: see `steps`; follows: K per sample that the level of a sensor without offset may
    change by; others: K by which the other motors' sensors have jumped.
    """
    size, settled = len(x), len(x) - before - after
    if state[SINCE] >= 0.0:
        state[SINCE] += 1.0
        if state[SINCE] >= settled:
            moved = _jump(x, before, after, state[LEVEL])
            # What the others show may explain a jump, but makes none.
            if moved * others > 0.0:
                moved -= math.copysign(min(abs(moved), abs(others)), moved)
            if abs(moved) > 0.8 * step:
                state[OFF] += moved
                if abs(state[OFF]) < back:
                    state[OFF] = 0.0
            if math.isfinite(moved):
                state[SINCE] = -1.0
            elif state[SINCE] > settled:
                # Too few readings since: wait, with what came after in its place.
                state[SINCE] = float(settled)
        return
    now = _median(x, size - after - before, size - after)
    known = math.isfinite(now)
    state[OLD] = 0.0 if known else state[OLD] + 1.0
    # Over a short hole the level is what it was; over a long one anything may warm.
    if known or state[OLD] > settled:
        state[LEVEL] = now
    level = state[LEVEL]
    if state[OFF] == 0.0 and math.isfinite(level):
        home = level if math.isnan(state[HOME]) else state[HOME]
        state[HOME] = home + min(max(level - home, -follows), follows)
    elif abs(level - state[HOME]) < back:
        # It was two bursts in a row, or has crept back.
        state[OFF] = 0.0
    # A median that is no number is not far from anything.
    if abs(_median(x, size - after, size) - level) > step:
        state[SINCE] = 0.0


def follow(
    x: Array, counts: NDArray[np.int64], step: float, back: float, follows: float, out: Array
) -> None:
    """Fill out (K, S) K: offsets of S sensors with residuals x (K, S).

    counts: samples before, after, and until a step has settled.
    """
    before, after, settled = counts
    size = before + after + settled
    padded = np.full(x.shape[0] + settled, np.nan)
    state = np.empty(STATE)
    for s in range(x.shape[1]):
        padded[settled:] = x[:, s]
        start(state)
        for k in range(before + after, x.shape[0]):
            one(padded[k + settled + 1 - size : k + settled + 1], state, before, after, step, back,
                follows)  # fmt: skip
            out[k, s] = state[OFF]
