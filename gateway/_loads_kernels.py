"""Compiled side of `loads`: a loop over drives, so the twin is the same function uncompiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from gateway.loads import (
    COASTING,
    ENOUGH_TO_COMPARE,
    FOLLOWING_NS,
    SHARE_FLOOR,
    SHARE_UNKNOWN,
)

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.loads import Instant, Rotors
    from gateway.slow import SlowState
    from gateway.tracks import Told

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

_TRACKING = 2  # Health
_BAD = 2  # Flag
_SECOND = 1_000_000_000
_NEVER = -(1 << 63)


@inlined
def insert(x: float, count: int, rank: Array) -> None:
    """One more number into the ascending first `count` of rank."""
    place = count
    while place > 0 and rank[place - 1] > x:
        rank[place] = rank[place - 1]
        place -= 1
    rank[place] = x


@inlined
def middle(count: int, rank: Array) -> float:
    """Median of the first `count`; of an even number the lower of the two."""
    return math.nan if count == 0 else float(rank[(count - 1) // 2])


@inlined
def _zero(x: float) -> float:
    """A number that is not known counts as none."""
    return 0.0 if math.isnan(x) else x


@inlined
def _obeys(k: int, now: int, rotors: Rotors) -> bool:
    """Whether drive k follows its own flag, or followed it just now."""
    return bool(rotors.lost_ns[k] != _NEVER and now < rotors.lost_ns[k] + FOLLOWING_NS)


@inlined
def _median(now: int, rotors: Rotors) -> float:
    """Of the loads that are known, of drives that do not follow their own flag; NaN of none."""
    count = 0
    for k in range(rotors.load.shape[0]):
        if not _obeys(k, now, rotors) and not math.isnan(rotors.load[k]):
            insert(rotors.load[k], count, rotors.rank)
            count += 1
    return middle(count, rotors.rank)  # type: ignore[no-any-return,unused-ignore]


@inlined
def _shares(
    now: int, slow: SlowState, fresh: Flags, follows: Flags, rotors: Rotors, at: Instant
) -> None:
    """Each drive's torque command over the largest one; 1 where that says nothing.

    The drives' Status frames are up to a cycle apart, so commands that change with the train
    differ by their age alone. They are compared while all are steady; a drive that follows
    its own flag (down to 30 % and back) is compared always.
    """
    largest, calm = 0.0, True
    for k in range(fresh.shape[0]):
        at.share[k] = 1.0
        calm = calm and (slow.steady[k] or follows[k])
        if fresh[k]:
            largest = max(largest, abs(slow.command[k]) / rotors.rated[k])
    if largest <= COASTING:
        return
    common = _median(now, rotors)
    for k in range(fresh.shape[0]):
        if not fresh[k] or not (calm or follows[k]):
            continue
        share, load = abs(slow.command[k]) / rotors.rated[k] / largest, rotors.load[k]
        # A command that makes the load less like the others' is not what the drive obeys.
        off = abs(load / share - common) if share > 0.0 else math.inf
        if not abs(load - common) < off:
            at.share[k] = share


@inlined
def _excess(k: int, speed: float, tick_s: float, rotors: Rotors) -> float:
    """Torque that accelerated a rotor, per unit, on the average of a tick: largest of two.

    A quick speed control takes the torque back within a tick; the speed that it could not hold
    shows for longer. speed: NaN where it is not known, or not asked for.
    """
    before, gained_before = rotors.speed[k], rotors.gain[k]
    if math.isnan(before):
        before, gained_before = speed, 0.0
    rotors.speed[k] = speed
    if math.isnan(speed):
        return 0.0
    gained: float = rotors.inertia[k] * (speed - before) / tick_s / rotors.rated[k]
    rotors.gain[k] = gained
    larger: float = gained if abs(gained) >= abs(gained_before) else gained_before
    return larger


@lean
def prepare(
    told: Told, slow: SlowState, fresh: Flags, flag: Ints, since_ns: Ints, now: int, tick_s: float,
    rotors: Rotors, at: Instant, responses: Records,
) -> None:  # fmt: skip
    """Fills `at`, loads in the direction of travel, and `responses`, loads beside the commands.

    fresh (N,): the command is known; flag, since_ns (N,): the drives' adhesion flags so far, and
    since when their evidence is the same: a drive follows its own flag, and for some time after.
    A drive mounted the other way round turns and pulls the other way; its own speed's sign brings
    it to the train's direction. `responses` are in each motor's own direction.
    """
    for k in range(fresh.shape[0]):
        at.follows[k] = flag[k] == _BAD or now < since_ns[k] + FOLLOWING_NS
        if flag[k] == _BAD:
            rotors.lost_ns[k] = now
    _shares(now, slow, fresh, at.follows, rotors, at)
    judged = 0
    for k in range(fresh.shape[0]):
        sound = told.health[k] == _TRACKING and not rotors.above[k]
        at.known[k] = sound and at.share[k] >= SHARE_UNKNOWN
        at.share[k] = max(at.share[k], SHARE_FLOOR)
        forward = 1.0 if _zero(told.speed[k]) >= 0.0 else -1.0
        at.load[k] = forward * _zero(told.load[k]) / rotors.rated[k]
        judged += at.known[k]
    for k in range(fresh.shape[0]):
        rated, speed = rotors.rated[k], told.speed[k]
        mine = responses[k]
        mine["load"] = _zero(told.load[k]) / rated + rotors.taken[k]
        asked = speed if judged < ENOUGH_TO_COMPARE else math.nan
        mine["acceleration_torque"] = _excess(k, asked, tick_s, rotors)
        mine["command"] = _zero(slow.command[k]) / rated
        mine["previous_command"] = _zero(slow.before[k]) / rated
        mine["command_age_s"] = (now - slow.command_ns[k]) / _SECOND
        mine["usable"] = fresh[k] and at.known[k]
