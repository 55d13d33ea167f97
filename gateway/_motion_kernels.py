"""Compiled side of `motion`: the observers, and where measured speeds contradict the currents.

Scalar by nature, a loop over drives, so the twin is the same function uncompiled (`.py_func`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean
from dbc.records import CURRENT_CALIBRATION
from estimators import observer
from estimators.observer import LoadState, Mechanics

if TYPE_CHECKING:
    from dbc.records import Columns
    from gateway.inputs import Inputs
    from gateway.motion import Limits, Memory
    from gateway.slow import Readings
    from gateway.tracks import Told

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_UNKNOWN, _CONVERGING, _TRACKING, _PREDICTING, _DIVERGED, _INPUT_INVALID = range(6)  # Health
_STARTING, _NOT_AVAILABLE = 1, 6  # Reason
_SECOND = 1_000_000_000
_SENSORS = CURRENT_CALIBRATION.itemsize
_is_single_axis_current = symbol("is_single_axis_current")
_first, _observe = lean(observer.first), lean(observer.observe)


@inlined
def _single_axis(k: int, w_e: float, sensors: Columns) -> bool:
    """Drive k turns, and its current swings on one line."""
    return bool(_is_single_axis_current(sensors.ctypes.data + k * _SENSORS, w_e))


@inlined
def _keep(k: int, load: LoadState, memory: Memory) -> None:
    for j in range(7):
        memory.observer[k, j] = load[j]


@inlined
def _kept(k: int, memory: Memory) -> LoadState:
    row = memory.observer
    return LoadState(row[k, 0], row[k, 1], row[k, 2], row[k, 3], row[k, 4], row[k, 5], row[k, 6])


@lean
def observe_motion(
    readings: Readings, count: int, flux: Array, memory: Memory, limits: Limits
) -> None:
    """Readings of one tick, in order of time; only the first `count`.

    flux (N,): a drive's magnets' over that of the data sheet, from which it computes the torque
    that it sends; NaN where nothing is known.
    """
    for r in range(count):
        k, t_ns = readings.drive[r], readings.t_ns[r]
        torque = readings.torque[r] * (1.0 if math.isnan(flux[k]) else flux[k])
        m = limits.mechanics
        mechanics = Mechanics(m[k, 0], m[k, 1], m[k, 2], m[k, 3])
        # The cycle is exact, stamps jitter.
        cycles = round((t_ns - memory.last_ns[k]) / limits.period_ns)
        memory.last_ns[k] = t_ns
        if not memory.begun[k] or cycles > limits.most_missing:
            _keep(k, _first(readings.speed[r], torque, mechanics), memory)
            memory.begun[k] = True
            memory.readings[k] = 0
        elif cycles > 0:
            dt = cycles * limits.period_ns / _SECOND
            _keep(k, _observe(_kept(k, memory), readings.speed[r], torque, dt, mechanics), memory)
            memory.readings[k] += 1


@inlined
def _nothing(k: int, health: int, told: Told) -> None:
    """No numbers of drive k."""
    told.health[k] = health
    told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan


@inlined
def _contradicts(k: int, measured: float, told: Told, memory: Memory, limits: Limits) -> bool:
    """True once drive k's speeds have contradicted one another for long enough."""
    known = not math.isnan(measured)
    turns = known and abs(limits.pole_pairs[k] * measured) > limits.turning_rad_s
    # Fresh currents of a drive that turns, and no lock.
    lost = turns and told.health[k] == _CONVERGING
    memory.unlocked_ns[k] = memory.unlocked_ns[k] + limits.tick_ns if lost else 0
    if memory.unlocked_ns[k] > limits.locked_ns:
        return True
    # Whatever was found stands until a tracked speed agrees again.
    if known and told.health[k] == _TRACKING:
        limit = max(limits.tolerance_rad_s, limits.tolerance * abs(measured))
        speed = 0.0 if math.isnan(told.speed[k]) else told.speed[k]
        memory.apart[k] = memory.apart[k] + 1 if abs(speed - measured) > limit else 0
    return bool(memory.apart[k] >= limits.ticks)


@inlined
def _by_observer(k: int, fresh: bool, told: Told, memory: Memory, limits: Limits) -> None:
    """What the observer says of drive k."""
    if not memory.begun[k] or not fresh:
        _nothing(k, _UNKNOWN, told)
        told.reason[k] = _NOT_AVAILABLE
    elif memory.readings[k] < limits.settled_readings:
        _nothing(k, _CONVERGING, told)
    else:
        load = _kept(k, memory)
        told.health[k] = _TRACKING
        told.speed[k], told.load[k] = load.w, load.T_L
        told.sigma[k], told.nis[k] = math.sqrt(load.P_LL), load.nis


@inlined
def _fade(k: int, observed: bool, told: Told, memory: Memory, limits: Limits) -> None:
    """No bump where the source changes: the difference fades."""
    load = told.load[k]
    if math.isnan(memory.load[k]):
        memory.offset[k] = 0.0
    elif observed != memory.observed[k]:
        memory.offset[k] = memory.load[k] - load
    memory.observed[k] = observed
    memory.offset[k] *= limits.fade if abs(memory.offset[k]) > limits.faded_nm else 0.0
    memory.load[k] = load + memory.offset[k]
    if memory.offset[k] != 0.0:
        told.load[k] = memory.load[k]


@inlined
def _merge(
    k: int, fresh: bool, sampled: bool, any_beyond: bool, told: Told, memory: Memory, limits: Limits
) -> None:
    """The estimate of drive k to use; one whose input cannot be believed stays what it is.

    Drives are compared, and filter and observer follow a load step at different speeds: where one
    drive needs the observer, all that can use it.
    """
    invalid = told.health[k] == _INPUT_INVALID
    ready = fresh and memory.readings[k] >= limits.settled_readings
    observed = memory.beyond[k] or (any_beyond and ready)
    if observed and not invalid:
        _by_observer(k, fresh, told, memory, limits)
        # It goes on with `Motion` alone, but nothing shows any more that this is plausible.
        if not sampled and told.health[k] == _TRACKING:
            told.health[k] = _PREDICTING
    if invalid or math.isnan(told.load[k]) or told.health[k] != _TRACKING:
        memory.load[k] = math.nan
    else:
        _fade(k, observed, told, memory, limits)


@lean
def merge_motion(
    inputs: Inputs, sensors: Columns, until_ns: Ints, now: int, told: Told, memory: Memory,
    limits: Limits,
) -> None:  # fmt: skip
    """What each drive is told to be, measured speeds considered; changes `told`.

    inputs: speeds of fresh `Motion`, and whose currents are fresh; until_ns (N,): until when a
    drive's values are implausible (`plausibility`). A drive whose input cannot be what it seems is
    marked in `memory.wrong`.
    """
    measured = inputs.speed
    any_beyond = False
    for k in range(measured.shape[0]):
        w = measured[k]
        if math.isnan(w):
            w = 0.0 if math.isnan(told.speed[k]) else told.speed[k]
        limit = limits.limit_w_e * (1.0 - limits.hysteresis if memory.beyond[k] else 1.0)
        memory.beyond[k] = abs(limits.pole_pairs[k] * w) > limit
        any_beyond |= memory.beyond[k]
    for k in range(measured.shape[0]):
        told.reason[k] = _STARTING
        fresh = not math.isnan(measured[k])
        straight = fresh and _single_axis(k, limits.pole_pairs[k] * measured[k], sensors)
        apart = not memory.beyond[k] and _contradicts(k, measured[k], told, memory, limits)
        implausible = now < until_ns[k]
        if straight or implausible:
            _nothing(k, _INPUT_INVALID, told)
        _merge(k, fresh, inputs.fresh[k], any_beyond, told, memory, limits)
        if apart:
            _nothing(k, _INPUT_INVALID, told)
            told.reason[k] = _STARTING
        memory.wrong[k] = straight or apart or implausible
