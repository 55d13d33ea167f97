"""Measured speeds beside estimates in Python, which `gateway/core/motion.c` is compared with."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND
from tests.columns import Inputs, Told
from tests.reference import load_observer
from tests.reference.load_observer import LoadState, Mechanics
from tests.sample_rows import Readings

HYSTERESIS: Final = 0.05
SETTLED_READINGS: Final = 5
MOST_MISSING: Final = 5
"""Periods without a reading after which the observer starts anew."""
SPEED_TOLERANCE: Final = 0.15
SPEED_TOLERANCE_RAD_S: Final = 5.0
"""At the rotor. The flux may be off by a tenth, and Motion is up to 10 ms old in a slip."""
TICKS: Final = 5
"""In a row that the two speeds must be apart."""
LOCKED_NS: Final = SECOND
"""A rotor that turns is locked to within this, or its currents and voltages are not what they seem:
an open phase, a wrong motor."""

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_UNKNOWN, _CONVERGING, _TRACKING, _PREDICTING, _DIVERGED, _INPUT_INVALID = range(6)  # Health
_STARTING, _NOT_AVAILABLE = 1, 6  # Reason
_SECOND = 1_000_000_000
MEAN_NS = 100_000_000


class Memory(NamedTuple):
    """What is remembered of every drive, (N,).

    observer (N, 8): its `LoadState`, once it has begun; last_ns: stamp of the last reading;
    readings: since it began; beyond: the drive turns too fast for its current samples; crawls: too
    slowly for its flux to be seen; away: its wheel has run away or locked (given); mean: the speed
    of the filter over the last tenth of a second; apart: ticks in a row that the two speeds have
    been; unlocked_ns: how long it has turned, by its own word, with no lock to it; wrong: its
    input cannot be what it seems.
    """

    observer: Array
    begun: Flags
    last_ns: Ints
    readings: Ints
    beyond: Flags
    apart: Ints
    unlocked_ns: Ints
    wrong: Flags
    crawls: Flags
    away: Flags
    mean: Array


class Limits(NamedTuple):
    """When what is believed: the constants above; mechanics (N, 4) as `observer.Mechanics`."""

    mechanics: Array
    pole_pairs: Array
    period_ns: int
    tick_ns: int
    limit_w_e: float
    hysteresis: float
    most_missing: int
    settled_readings: int
    turning_rad_s: float
    locked_ns: int
    tolerance: float
    tolerance_rad_s: float
    ticks: int
    crawl_w_e: float


def memory(n: int) -> Memory:
    """Nothing remembered."""
    zeros = [np.zeros(n, dtype=np.int64) for _ in range(4)]
    flags = [np.zeros(n, dtype=np.bool_) for _ in range(5)]
    return Memory(
        np.zeros((n, len(LoadState._fields))), flags[0], zeros[0], zeros[1], flags[1], zeros[2],
        zeros[3], flags[2], flags[3], flags[4], np.full(n, np.nan),
    )  # fmt: skip


def _keep(k: int, load: LoadState, memory: Memory) -> None:
    memory.observer[k] = load


def _kept(k: int, memory: Memory) -> LoadState:
    return LoadState(*memory.observer[k].tolist())


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
            _keep(k, load_observer.first(readings.speed[r], torque, mechanics), memory)
            memory.begun[k] = True
            memory.readings[k] = 0
        elif cycles > 0:
            dt = cycles * limits.period_ns / _SECOND
            before, speed = _kept(k, memory), readings.speed[r]
            _keep(k, load_observer.observe(before, speed, torque, dt, mechanics), memory)
            memory.readings[k] += 1


def _nothing(k: int, health: int, told: Told) -> None:
    """No numbers of drive k."""
    told.health[k] = health
    told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan


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
        told.sigma[k], told.nis[k] = load.sigma, load.nis


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
    told.estimates["by_observer"][k] = observed and not invalid
    told.estimates["crawls"][k] = observed and memory.crawls[k] and not invalid
    if observed and not invalid:
        _by_observer(k, fresh, told, memory, limits)
        # It goes on with `Motion` alone, but nothing shows any more that this is plausible.
        if not sampled and told.health[k] == _TRACKING:
            told.health[k] = _PREDICTING


def merge_motion(
    inputs: Inputs, open_phase: Callable[[int, float], bool], until_ns: Ints, now: int, told: Told,
    memory: Memory, limits: Limits,
) -> None:  # fmt: skip
    """What each drive is told to be, measured speeds considered; changes `told`.

    inputs: speeds of fresh `Motion`, and whose currents are fresh; until_ns (N,): until when a
    drive's values are implausible; open_phase: by drive and electrical speed. A drive whose input
    cannot be what it seems is marked in `memory.wrong`.
    """
    measured = inputs.speed
    any_beyond = False
    for k in range(measured.shape[0]):
        own = math.nan if memory.wrong[k] else told.speed[k]
        settled = told.health[k] == _TRACKING and not math.isnan(memory.mean[k])
        share = limits.tick_ns / (limits.tick_ns + MEAN_NS)
        memory.mean[k] = (1.0 - share) * memory.mean[k] + share * own if settled else own
        w = measured[k]
        if math.isnan(w):
            w = 0.0 if math.isnan(memory.mean[k]) else memory.mean[k]
        limit = limits.limit_w_e * (1.0 - limits.hysteresis if memory.beyond[k] else 1.0)
        memory.beyond[k] = abs(limits.pole_pairs[k] * w) > limit
        least = limits.crawl_w_e * (1.0 + limits.hysteresis if memory.crawls[k] else 1.0)
        memory.crawls[k] = abs(limits.pole_pairs[k] * measured[k]) < least
        any_beyond |= memory.beyond[k] and not memory.wrong[k]
    right = ~memory.wrong
    faster = right & ~np.isnan(measured) & ~memory.crawls & ~memory.away
    any_beyond |= bool((memory.crawls & right).any() and not faster.any())
    for k in range(measured.shape[0]):
        told.reason[k] = _STARTING
        fresh = not math.isnan(measured[k])
        straight = fresh and open_phase(k, limits.pole_pairs[k] * measured[k])
        apart = not memory.beyond[k] and _contradicts(k, measured[k], told, memory, limits)
        implausible = now < until_ns[k]
        if straight or implausible:
            _nothing(k, _INPUT_INVALID, told)
        _merge(k, fresh, inputs.fresh[k], any_beyond, told, memory, limits)
        if apart:
            _nothing(k, _INPUT_INVALID, told)
            told.reason[k] = _STARTING
        memory.wrong[k] = straight or apart or implausible
