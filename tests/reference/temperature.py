"""Temperature sensors in Python, which `gateway/core/temperature.c` is compared with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_NEVER = -(1 << 63)
_UNKNOWN, _NONE, _BIAS, _STUCK, _LOST = 0, 1, 5, 6, 7  # FaultClass

_SECOND = 1_000_000_000
LOST_NS = _SECOND // 2
"""A not-available code for longer than this is a lost sensor; real ones drop for a moment."""
STEP_READINGS = 3
SUDDEN = 0.4
"""Share of a step that has to come from one reading to the next. What comes in smaller portions is
heat's: a small motor's winding may warm by kelvins within a second."""
QUICKEST_K = 20.0
"""From one reading to the next: a sensor's, in whatever portions it comes."""
FULL_C = 300.0
"""The most that a reading can say: a motor that has warmed up to it is as hot or hotter."""
COLDEST_C = -50.0
"""No train runs in such cold."""
FULL_STEPS = 5.0
"""A sensor that was further below it, in limits of a step, has jumped there."""
FORGET_NS = 10 * _SECOND
"""After longer without a valid value the motor may have changed by more than a step's limit."""
TOGETHER = 2
"""Faults of all sensors within this many readings of one another have a common source."""
STALE_CYCLES = 3
"""Of a drive that has been silent for longer no sensor is called stuck."""


class Points(NamedTuple):
    """The sensors; (N, P) and, from `heard_ns` on, (N,)."""

    raw: Ints
    changed_ns: Ints
    valid_ns: Ints
    value: Array
    level: Array
    stepped: Ints
    jump: Array
    slope: Array
    full: Bools
    bias_k: Array
    valid_at: Ints
    jumped_at: Ints
    seen: Bools
    configured: Bools
    limit_k: Array
    hold_ns: Ints
    heard_ns: Ints
    first_ns: Ints
    readings: Ints
    moved: Bools
    wrong: Bools
    period_ns: int


def start(configured: Bools, limit_k: Array, hold_ns: Ints, period_ns: int) -> Points:
    """Nothing heard yet. Takes (N, P) arrays."""
    shape = configured.shape

    def ints(value: int = 0) -> Ints:
        return np.full(shape, value, dtype=np.int64)

    def flags() -> Bools:
        return np.zeros(shape, dtype=np.bool_)

    value, level, jump, slope, bias_k = (np.zeros(shape) for _ in range(5))
    heard_ns, first_ns = (np.full(shape[0], _NEVER, dtype=np.int64) for _ in range(2))
    return Points(
        ints(-1), ints(), ints(_NEVER), value, level, ints(), jump, slope, flags(), bias_k, ints(),
        ints(), flags(), configured, limit_k, hold_ns, heard_ns, first_ns,
        np.zeros(shape[0], dtype=np.int64), flags(), flags(), period_ns,
    )  # fmt: skip


def note_reading(j: int, t: int, points: Points) -> None:
    """A reading of drive j has come; its points follow."""
    if points.heard_ns[j] == _NEVER:
        points.first_ns[j] = t
    points.heard_ns[j] = t
    points.readings[j] += 1


def take_point(j: int, k: int, t: int, value: float, raw: int, points: Points) -> None:
    """A valid value, degC, of a configured point; raw: in tenths."""
    valid, bias = points.valid_ns[j, k], points.bias_k[j, k]
    held = t - points.changed_ns[j, k] > points.hold_ns[j, k] and not points.full[j, k]
    released = points.seen[j, k] and raw != points.raw[j, k] and held
    back = valid == _NEVER or t - valid > FORGET_NS or released
    points.moved[j, k] |= points.seen[j, k] and raw != points.raw[j, k]
    if raw != points.raw[j, k] or back:
        points.raw[j, k], points.changed_ns[j, k] = raw, t
    # An offset once found stays: silence does not clear it.
    if back and bias == 0.0:
        points.level[j, k] = value
    step = value - points.level[j, k] - bias
    limit = points.limit_k[j, k]
    hot_at_once = value >= FULL_C and (back or points.wrong[j, k])
    wrong = value < COLDEST_C or hot_at_once
    if wrong and not points.wrong[j, k]:
        points.jumped_at[j, k] = points.readings[j]
    points.wrong[j, k] = wrong
    full = value >= FULL_C and not back and abs(step) < FULL_STEPS * limit
    points.full[j, k] = full
    change, passed = 0.0, 1
    if not back:
        change = value - points.value[j, k]
        passed = max(round((t - valid) / points.period_ns), 1)
    slope = points.slope[j, k]
    beside = change - slope * passed
    if abs(step) > (0.5 if bias * step < 0.0 else 1.0) * limit and not full:
        points.stepped[j, k] += 1
        points.jump[j, k] = max(points.jump[j, k], min(abs(change), abs(beside)))
    else:
        points.stepped[j, k], points.jump[j, k] = 0, 0.0
        points.level[j, k] += 0.2 * step
    if points.stepped[j, k] >= STEP_READINGS:
        # No motor jumps: what stays after a sudden step is the sensor's, not heat's.
        if points.jump[j, k] > min(SUDDEN * abs(step), QUICKEST_K):
            points.bias_k[j, k] = bias + step
            points.jumped_at[j, k] = points.readings[j]
            if abs(bias + step) < limit:
                points.bias_k[j, k] = 0.0
        else:
            points.level[j, k] += step
        points.stepped[j, k], points.jump[j, k] = 0, 0.0
    points.value[j, k] = value
    points.slope[j, k] = slope + 0.2 * (change / passed - slope)
    points.seen[j, k] = True
    points.valid_ns[j, k] = t
    points.valid_at[j, k] = points.readings[j]


def fault(j: int, k: int, now: int, points: Points) -> int:
    """`FaultClass` of one sensor; unknown while it has never been heard, none if there is none."""
    if not points.configured[j, k]:
        return _NONE
    heard, valid = points.heard_ns[j], points.valid_ns[j, k]
    if heard == _NEVER:
        return _UNKNOWN
    since = points.first_ns[j] if valid == _NEVER else valid
    if heard - since > LOST_NS:
        return _LOST
    if valid == _NEVER:
        return _UNKNOWN
    held = now - points.changed_ns[j, k] > points.hold_ns[j, k] and not points.full[j, k]
    if held and now - heard <= STALE_CYCLES * points.period_ns:
        return _STUCK
    return _BIAS if points.bias_k[j, k] != 0.0 or points.wrong[j, k] else _NONE


def believe(now: int, points: Points, out: Bools) -> None:
    """Fills out (N, P): configured, heard and without fault."""
    for j in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[j, k] = points.seen[j, k] and fault(j, k, now, points) == _NONE


def booting(j: int, points: Points) -> bool:
    """True while a configured sensor of drive j has never given a valid value."""
    for k in range(points.configured.shape[1]):
        if points.configured[j, k] and points.valid_ns[j, k] == _NEVER:
            return True
    return False


def _common(j: int, now: int, points: Points) -> int:
    """Offset or lost, where all sensors of drive j, at least two, are since the same moment."""
    fitted = 0
    all_of, first, last = _NONE, 0, 0
    for k in range(points.configured.shape[1]):
        if not points.configured[j, k]:
            continue
        found = fault(j, k, now, points)
        at = points.jumped_at[j, k] if found == _BIAS else points.valid_at[j, k]
        if not fitted:
            all_of, first, last = found, at, at
        elif found != all_of:
            return _NONE
        first, last = min(first, at), max(last, at)
        fitted += 1
    if fitted > 1 and last - first <= TOGETHER and all_of in (_BIAS, _LOST):
        return all_of
    return _NONE


def verdict(j: int, now: int, points: Points) -> tuple[int, int]:
    """Drive j's first sensor fault and whose it is, `FaultClass` and `FaultSensor`."""
    common = _common(j, now, points)
    if common != _NONE:
        return common, 0
    for k in range(points.configured.shape[1]):
        found = fault(j, k, now, points)
        if found in (_BIAS, _STUCK, _LOST):
            return found, k + 1
    return _NONE, 0
