"""Creep and utilisation in NumPy, which `gateway/core/creep.c` is compared with."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

OWN_CREEP: Final = 0.01
"""Of the wheels that the reference speed is taken from."""
SPEED_SIGMA: Final = 0.1
LEAST_SPEED: Final = 3.0
FASTEST: Final = 0.15
"""Per unit of rated torque, on the rotor alone: the fastest change of a train."""
MOST_SIGMA: Final = (0.254, 1.27)
LEAST_SIGMA: Final = 0.005


class Wheels(NamedTuple):
    """What is given, (N,). turning: signed speed; motor: first rotor with the same ratings.

    load, load_sigma: Nm, as published; tracked: the filter tracks; good: the flag is `Adhering`.
    """

    motor: Ints
    rated: Array
    inertia: Array
    speed: Array
    turning: Array
    train_speed: Array
    tracked: NDArray[np.bool_]
    good: NDArray[np.bool_]
    load: Array
    load_sigma: Array


class Memory(NamedTuple):
    """(N,): for how long no wheel of a motor has adhered, s; the reference speed until then; sign
    of the speed of one that did."""

    unsure_s: Array
    sure_speed: Array
    way: Ints


def estimate(given: Wheels, memory: Memory, tick_s: float) -> Array:
    """(4, N): creep, its sigma, utilisation, its sigma; NaN: not known. Changes the memory."""
    reference = given.train_speed[given.motor]
    reference = np.where(reference >= LEAST_SPEED, reference, np.nan)
    way = np.where(given.turning < 0.0, -1, 1)
    sure = given.good & given.tracked
    memory.way[:] = np.where(np.isnan(reference), 0, np.where(sure, way, memory.way))
    sign = np.where(memory.way * way < 0, -1.0, 1.0)
    creep = sign * np.abs(given.speed) / reference - 1.0
    sigma = np.full(len(creep), np.nan)
    for first in np.unique(given.motor):
        mine = given.motor == first
        held = mine & sure & ~np.isnan(creep)
        memory.unsure_s[first] = 0.0 if held.any() else memory.unsure_s[first] + tick_s
        if held.any():
            memory.sure_speed[first] = reference[first]
        drift = FASTEST * given.rated[first] / given.inertia[first] * memory.unsure_s[first]
        drift += abs(reference[first] - memory.sure_speed[first])
        spread = np.mean(creep[held] ** 2) if held.any() else 0.0
        sigma[mine] = np.sqrt(OWN_CREEP**2 + spread + (drift / reference[first]) ** 2)
    sigma = np.hypot((1.0 + creep) * sigma, SPEED_SIGMA / reference)
    used, used_sigma = np.abs(given.load) / given.rated, given.load_sigma / given.rated
    pairs = ((creep, sigma), (used, np.maximum(used_sigma, LEAST_SIGMA)))
    out = np.full((4, len(creep)), np.nan)
    for k, ((number, spread), most) in enumerate(zip(pairs, MOST_SIGMA, strict=True)):
        known = np.isfinite(number) & (spread <= most)
        out[2 * k : 2 * k + 2, known] = np.stack([number, spread])[:, known]
    return out
