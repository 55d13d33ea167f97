"""The bound of the train's speed in NumPy, which `gateway/core/train_speed.c` is compared with."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import Flag

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_EFFORT: Final = 0.1
"""Mean load, per unit of rated torque: wheels that carry less grip."""
CATCH_UP: Final = 4.0
"""A bound that has run behind its train returns so many times as fast."""
FASTEST, HARDER = 0.15, 2.0
"""Per unit of rated torque on the rotor alone: fastest change of a train; of the second bound."""
UNSEEN_S: Final = 1.0
MOST_SLIP: Final = 0.06
SLIP_OF_TWO: Final = 0.08
MOST_DIFFERENCE: Final = 0.1
"""While a diameter has been learnt for less than `ROUGH_S`."""
ROUGH_S: Final = 0.5
SLIDING_SLIP: Final = 0.2
SLIDING_S: Final = 0.05
AHEAD_S: Final = 0.05
HILL, ROTATING = 0.02, 0.15
"""What motors explain of that fastest change, with the share of the mean load."""
CARRIES: Final = 0.5
"""Share of the mean load: who carries as much for so long, ahead of the bound, shows the train."""
LEAST_SPEED_RAD_S: Final = 3.0


class TrainSpeed(NamedTuple):
    """Memory, (N,): bounds (2, N), rad/s, and unseen_s stand at the first of each motor.

    slip: how far a rotor is beyond the first bound, for the side of the effort; sliding_s: for how
    long it has been `SLIDING_SLIP` beyond the second one; sliding: too long, and away; ahead_s: for
    how long one whose diameter is known has been ahead of the first bound, and has carried.
    """

    bounds: Array
    unseen_s: Array
    slip: Array
    sliding_s: Array
    sliding: Flags
    ahead_s: Array


def start(n: int) -> TrainSpeed:
    """Nothing known."""
    return TrainSpeed(
        np.full((2, n), np.nan), np.zeros(n), np.full(n, np.nan), np.zeros(n), np.zeros(n, bool),
        np.zeros(n),
    )  # fmt: skip


def _lead(speed: Array, load: Array, sure: Flags, braking: bool) -> float:
    """Of one motor: who leads of those that are sure, else of all that carry with the train."""
    tracked = (load <= 0.0 if braking else load >= 0.0) & np.isfinite(speed)
    chosen = tracked & sure if (tracked & sure).any() else tracked
    if not chosen.any():
        return math.nan
    return float(speed[chosen].max() if braking else speed[chosen].min())


def follow(
    memory: TrainSpeed, motor: NDArray[np.int64], speed: Array, load: Array,
    flag: NDArray[np.int64], lost: Flags, apart: Flags, rated: Array, inertia: Array,
    learnt_s: Array, effort: float, braking: bool, tick_s: float,
) -> None:  # fmt: skip
    """One tick. speed, load (N,); rated torque and inertia of the rotor alone (N,)."""
    for first in np.unique(motor):
        mine = motor == first
        sure = (flag == Flag.GOOD) | (memory.ahead_s > AHEAD_S)
        lead = _lead(speed[mine], load[mine], sure[mine], braking)
        unseen = math.isnan(lead)
        memory.unseen_s[first] = memory.unseen_s[first] + tick_s if unseen else 0.0
        forget = memory.unseen_s[first] > UNSEEN_S or (not unseen and effort < LEAST_EFFORT)
        bad_rail = bool((lost | apart)[mine].any())
        slow = min(FASTEST, HILL + ROTATING * effort) if bad_rail else FASTEST
        for bound, share in zip(memory.bounds, (slow, max(FASTEST, HARDER * slow)), strict=True):
            most = share * rated[first] / inertia[first] * tick_s
            if forget or math.isnan(bound[first]):
                bound[first] = lead
            elif not unseen:
                low, high = (1.0, CATCH_UP) if braking else (CATCH_UP, 1.0)
                bound[first] = min(max(lead, bound[first] - low * most), bound[first] + high * most)
        near, far = memory.bounds[:, first]
        known = effort >= LEAST_EFFORT and min(near, far) >= LEAST_SPEED_RAD_S
        side = -1.0 if braking else 1.0
        memory.slip[mine] = side * (speed[mine] / near - 1.0) if known else np.nan
        ahead = (memory.slip < 0.0) & (learnt_s >= ROUGH_S) & (side * load > CARRIES * effort)
        memory.ahead_s[mine] = np.where(ahead, memory.ahead_s + tick_s, 0.0)[mine]
        beyond = known & (side * (speed / far - 1.0) > SLIDING_SLIP) & ~np.isnan(load)
        memory.sliding_s[mine] = np.where(beyond, memory.sliding_s + tick_s, 0.0)[mine]


def is_off(memory: TrainSpeed, k: int, learnt_s: float) -> bool:
    """Whether rotor k slips too much to be adhering."""
    most = SLIP_OF_TWO if len(memory.slip) < 3 else MOST_SLIP
    return bool(memory.slip[k] > (MOST_DIFFERENCE if learnt_s < ROUGH_S else most))
