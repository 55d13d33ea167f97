"""Compiled side of `train`: loops over drives, so each is its own twin."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from gateway import train as t

if TYPE_CHECKING:
    from gateway.slow import SlowState
    from gateway.tracks import Told
    from gateway.train import Train

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_UNKNOWN, _TRACKING, _INPUT_INVALID = 0, 2, 5  # Health
_RANGE, _NOT_AVAILABLE = 5, 6  # Reason
_GOOD, _BAD = 1, 2  # Flag
_ACCELERATION_TAU_S, _MOST_TORQUE = t.ACCELERATION_TAU_S, t.MOST_ACCELERATION_TORQUE
_ROTATING_FLOOR, _ROTATING_SHARE = t.ROTATING_FLOOR, t.ROTATING_SHARE
_SINGLE_CREDIT, _SINGLE_CHANGE = t.SINGLE_CREDIT, t.SINGLE_CHANGE
_LEAST_SPEED = t.LEAST_SPEED_RAD_S
_FOLLOWED_S, _ALONE_S = t.FOLLOWED_S, t.ALONE_S
_MOST_CREEP, _LEARN_CREEP, _MOST_APART = t.MOST_CREEP, t.LEARN_CREEP, t.MOST_APART
_DIAMETER_TAU_S, _MOST_DIAMETER = t.DIAMETER_TAU_S, t.MOST_DIAMETER
_DIAMETER_FIRST_S = t.DIAMETER_FIRST_S
_NEAR_S, _SLIDES_S, _AGAINST, _GRIPS = t.NEAR_S, t.SLIDES_S, t.AGAINST, t.GRIPS
_SPEEDS_APART, _SPEEDS_APART_RAD_S = t.SPEEDS_APART, t.SPEEDS_APART_RAD_S
_UNCOMMANDED, _UNCOMMANDED_RELATIVE = t.UNCOMMANDED, t.UNCOMMANDED_RELATIVE
_COMMAND_LATE_S, _ODD_S, _MOST_COMMAND = t.COMMAND_LATE_S, t.ODD_S, t.MOST_COMMAND
_FACTOR, _FACTOR_FLOOR = t.FACTOR, t.FACTOR_FLOOR
_LOAD_NEAR, _LOAD_NEAR_FLOOR = t.LOAD_NEAR, t.LOAD_NEAR_FLOOR


@inlined
def insert(x: float, count: int, rank: Array) -> None:
    """One more number into the ascending first `count` of rank."""
    place = count
    while place > 0 and rank[place - 1] > x:
        rank[place] = rank[place - 1]
        place -= 1
    rank[place] = x


@inlined
def middle(count: int, upper: bool, rank: Array) -> float:
    """Median of the first `count`; of an even number the upper or the lower of the two."""
    if count == 0:
        return math.nan
    return float(rank[count // 2 if upper else (count - 1) // 2])


@inlined
def _others(k: int, tracked: bool, upper: bool, train: Train) -> float:
    """Median speed of the other drives with the same motor, the `tracked` ones only or all.

    NaN without any.
    """
    count = 0
    for j in range(train.speed.shape[0]):
        alike = j != k and train.motor[j] == train.motor[k]
        counts = not math.isnan(train.speed[j]) and not (tracked and math.isnan(train.load[j]))
        if alike and counts:
            insert(train.speed[j], count, train.rank)
            count += 1
    return middle(count, upper, train.rank)  # type: ignore[no-any-return,unused-ignore]


@inlined
def _record_speeds(measured: Array, now: int, tick_s: float, told: Told, train: Train) -> float:
    """Speeds and loads of this tick; the train's load, in its direction."""
    total = 0.0
    for k in range(measured.shape[0]):
        tracking, speed = told.health[k] == _TRACKING, measured[k]
        train.load[k] = math.nan
        train.followed_s[k] = train.followed_s[k] + tick_s if tracking else 0.0
        if tracking:
            # Where the two speeds differ, neither is a measure for others.
            off = abs(speed - told.speed[k])
            apart = off > _SPEEDS_APART * abs(speed) + _SPEEDS_APART_RAD_S
            young = train.followed_s[k] < _FOLLOWED_S or now < train.doubt_ns[k]
            guess = young and off > _LEARN_CREEP * abs(speed)
            if apart:
                speed = math.nan
            elif not guess:
                speed = told.speed[k]
            train.load[k] = math.copysign(1.0, told.speed[k]) * told.load[k] / train.rated[k]
            total += train.load[k]
        train.speed[k] = speed
    return total


@inlined
def _accelerate(tick_s: float, braking: bool, train: Train) -> None:
    """What every rotor takes to follow the median of all, per unit of its rated torque."""
    count = 0
    for k in range(train.speed.shape[0]):
        speed = train.speed[k]
        if math.isnan(speed):
            # Beside `Motion` that is apart the drive is still followed.
            if math.isnan(train.load[k]):
                train.slow_speed[k] = math.nan
            continue
        slow = speed if math.isnan(train.slow_speed[k]) else train.slow_speed[k]
        train.slow_speed[k] = slow + tick_s / _ACCELERATION_TAU_S * (speed - slow)
        if abs(slow) >= _LEAST_SPEED:
            # Relative, so that it is the same for all diameters and gears.
            insert((speed - slow) / _ACCELERATION_TAU_S / slow, count, train.rank)
            count += 1
    rate = middle(count, braking, train.rank)
    for k in range(train.speed.shape[0]):
        torque = train.inertia[k] * rate * train.slow_speed[k] / train.rated[k]
        if math.isnan(torque):
            torque = 0.0
        load = 0.0 if math.isnan(train.load[k]) else abs(train.load[k])
        most = min(_MOST_TORQUE, _ROTATING_FLOOR + _ROTATING_SHARE * load)
        train.taken[k] = min(max(torque, -most), most)
        train.uncertain[k] = count < 2 and (
            abs(train.taken[k]) > _SINGLE_CREDIT or abs(rate) * _ACCELERATION_TAU_S > _SINGLE_CHANGE
        )


@inlined
def _own_change(k: int, train: Train) -> float:
    """By what share rotor k is faster than it was of late."""
    return float(train.speed[k] * train.diameter[k] / abs(train.slow_speed[k]) - 1.0)


@inlined
def _stays(k: int, tick_s: float, train: Train) -> bool:
    """Whether all other wheels have left that of drive k just now, and it is as fast as before."""
    others, away = 0, 0
    for j in range(train.speed.shape[0]):
        if j != k and train.motor[j] == train.motor[k] and not math.isnan(train.speed[j]):
            others += 1
            away += train.away[j]
    alone = others > 0 and away == others
    train.alone_s[k] = train.alone_s[k] + tick_s if alone else 0.0
    kept = abs(_own_change(k, train)) <= _LEARN_CREEP
    return bool(0.0 < train.alone_s[k] <= _ALONE_S and kept)


@inlined
def _runs_away(k: int, effort: float, train: Train) -> bool:
    """Whether drive k's wheel has left the others for the side that the effort takes it to.

    It has where its own speed has changed, not theirs; until it is back. effort: 1, braking -1.
    """
    slip = effort * train.creep[k]
    if train.away[k]:
        return bool(slip > _LEARN_CREEP)
    return bool(slip > _MOST_CREEP and effort * _own_change(k, train) > _LEARN_CREEP)


@inlined
def _speed_of_others(k: int, braking: bool, train: Train) -> float:
    """Median speed of the others that are followed, else of all; NaN without any."""
    others = _others(k, True, braking, train)
    return _others(k, False, braking, train) if math.isnan(others) else others  # type: ignore[no-any-return,unused-ignore]


@inlined
def _learn_diameters(tick_s: float, flag: Ints, operating: Flags, train: Train) -> None:
    """What is left between the speeds of wheels that adhere, while none is lost."""
    lost = False
    for k in range(flag.shape[0]):
        # A drive that is cut out keeps its flag, and stops nobody from learning.
        lost = lost or (flag[k] == _BAD and operating[k])
    for k in range(flag.shape[0]):
        settled = train.learnt_s[k] >= _DIAMETER_FIRST_S
        near = _LEARN_CREEP if settled else _MOST_DIAMETER + _LEARN_CREEP
        if lost or flag[k] != _GOOD or not abs(train.creep[k]) <= near:
            continue
        wanted = train.diameter[k] * (1.0 + train.creep[k])
        wanted = min(max(wanted, 1.0 - _MOST_DIAMETER), 1.0 + _MOST_DIAMETER)
        train.learnt_s[k] += tick_s
        tau = min(max(train.learnt_s[k], 10.0 * tick_s), _DIAMETER_TAU_S)
        train.diameter[k] += tick_s / tau * (wanted - train.diameter[k])


@inlined
def _compare_speeds(
    tick_s: float, braking: bool, flag: Ints, operating: Flags, train: Train
) -> None:
    """Who turns faster or slower than the others; learns diameters while nobody slips."""
    for k in range(flag.shape[0]):
        train.speed[k] = abs(train.speed[k])
    for k in range(flag.shape[0]):
        train.far[k] = False
        if train.learnt_s[k] < _DIAMETER_FIRST_S:
            # What has been learnt so far may be a slip that grows.
            others = _speed_of_others(k, braking, train)
            creep = train.speed[k] / others - 1.0 if others >= _LEAST_SPEED else 0.0
            train.far[k] = abs(creep) > _MOST_APART
    for k in range(flag.shape[0]):
        train.speed[k] /= train.diameter[k]
    for k in range(flag.shape[0]):
        others = _speed_of_others(k, braking, train)
        train.creep[k] = math.nan
        if others >= _LEAST_SPEED and not math.isnan(train.speed[k]):
            train.creep[k] = train.speed[k] / others - 1.0
            train.away[k] = _runs_away(k, -1.0 if braking else 1.0, train)
    for k in range(flag.shape[0]):
        stays = _stays(k, tick_s, train)
        train.uncertain[k] = train.uncertain[k] or (train.far[k] and not stays)
        if math.isnan(train.creep[k]):
            # Nobody sees whether it is back.
            train.uncertain[k] = train.uncertain[k] or train.apart[k]
            continue
        beyond = abs(train.creep[k]) > _MOST_CREEP and not stays
        train.near_s[k] = 0.0 if beyond else train.near_s[k] + tick_s
        train.apart[k] = train.near_s[k] == 0.0 or (train.apart[k] and train.near_s[k] < _NEAR_S)
        train.uncertain[k] = train.uncertain[k] or beyond
    _learn_diameters(tick_s, flag, operating, train)


@inlined
def _uncommanded(k: int, tick_s: float, slow: SlowState, told: Told, train: Train) -> bool:
    """Whether drive k has carried what it was not asked for, for too long."""
    load = told.load[k] / train.rated[k] + train.taken[k]
    sign = 1.0 if load >= 0.0 else -1.0
    asked = max(sign * slow.command[k], sign * slow.before[k], 0.0) / train.rated[k]
    beyond = sign * load - asked > _UNCOMMANDED + _UNCOMMANDED_RELATIVE * asked
    train.uncommanded_s[k] = train.uncommanded_s[k] + tick_s if beyond else 0.0
    return bool(train.uncommanded_s[k] > _COMMAND_LATE_S)


@inlined
def _others_load(k: int, train: Train) -> float:
    """Median load of the other drives, per unit; NaN without any."""
    loads = 0
    for j in range(train.load.shape[0]):
        if j != k and not math.isnan(train.load[j]):
            insert(train.load[j], loads, train.rank)
            loads += 1
    return middle(loads, False, train.rank)  # type: ignore[no-any-return,unused-ignore]


@inlined
def _like_others(k: int, train: Train) -> bool:
    """Whether drive k's load is near the median of the other drives'; false without any."""
    load = _others_load(k, train)
    return bool(abs(train.load[k] - load) <= _LOAD_NEAR * abs(load) + _LOAD_NEAR_FLOOR)


@inlined
def _slides(k: int, flag: int, tick_s: float, train: Train) -> bool:
    """Whether drive k's wheel slides under its load: no measure for those that hold.

    Nor is one that turns backwards; but a lost one that carries more is one that grips again.
    """
    load, others = train.load[k], _others_load(k, train)
    more = train.apart[k] and flag != _BAD and abs(load) > abs(others)
    train.slides_s[k] = train.slides_s[k] + tick_s if more else 0.0
    against = train.apart[k] and load * others < -_AGAINST * others * others
    grips = train.away[k] and more and abs(load) > abs(others) + _GRIPS
    return bool(train.slides_s[k] > _SLIDES_S or against or grips)


@inlined
def _odd_command(k: int, tick_s: float, slow: SlowState, commanded: Flags, train: Train) -> bool:
    """Whether drive k's command is far from the others' although its load is like theirs."""
    own = abs(slow.command[k]) / train.rated[k]
    commands = 0
    for j in range(commanded.shape[0]):
        if j != k and commanded[j]:
            insert(abs(slow.command[j]) / train.rated[j], commands, train.rank)
            commands += 1
    others = middle(commands, False, train.rank)
    # Written so that what is not known is not odd.
    far = own > _FACTOR * others + _FACTOR_FLOOR or own < others / _FACTOR - _FACTOR_FLOOR
    train.odd_s[k] = train.odd_s[k] + tick_s if far and _like_others(k, train) else 0.0
    return bool(train.odd_s[k] > _ODD_S or own > _MOST_COMMAND)


@inlined
def _unjudged(k: int, health: int, reason: int, told: Told) -> None:
    told.health[k], told.reason[k] = health, reason
    told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan


@lean
def assess_train(
    measured: Array, commanded: Flags, slow: SlowState, flag: Ints, now: int, tick_s: float,
    told: Told, train: Train,
) -> None:  # fmt: skip
    """Once a tick, after the estimates and before they are compared; see `train`.

    measured (N,): rotor speeds of fresh `Motion`, rad/s, NaN without; flag (N,): adhesion flags so
    far. Changes commanded (N,), false where a command cannot be believed, and `told` of drives that
    are not judged.
    """
    braking = _record_speeds(measured, now, tick_s, told, train) < 0.0
    _accelerate(tick_s, braking, train)
    _compare_speeds(tick_s, braking, flag, slow.operating, train)
    for k in range(flag.shape[0]):
        train.above[k] = False
        if not commanded[k] or told.health[k] != _TRACKING:
            train.uncommanded_s[k] = 0.0
        elif slow.operating[k] and _uncommanded(k, tick_s, slow, told, train):
            commanded[k] = False
            _unjudged(k, _INPUT_INVALID, _RANGE, told)
        else:
            above = train.uncommanded_s[k] > 0.0 and not _like_others(k, train)
            slides = _slides(k, flag[k], tick_s, train)
            train.above[k] = above or slides
    for k in range(flag.shape[0]):
        train.odd[k] = commanded[k] and _odd_command(k, tick_s, slow, commanded, train)
    for k in range(flag.shape[0]):
        commanded[k] = commanded[k] and not train.odd[k]
        if not slow.operating[k] and told.health[k] != _INPUT_INVALID:
            _unjudged(k, _UNKNOWN, _NOT_AVAILABLE, told)
