"""The train's rotors and commands in Python, which `gateway/core/train.c` is compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import NEVER, Flag, Health, Reason
from gateway.settings.config import Motor
from tests.columns import SlowState, Told
from tests.reference import train_speed

ACCELERATION_TAU_S: Final = 0.5
"""Time constant of a rotor's acceleration."""
BRAKE_TAU_S: Final = 0.1
"""And where friction brakes may be its cause."""
MOST_ACCELERATION_TORQUE: Final = 0.15
"""Per unit of rated torque: an emergency brake of 1.5 m/s^2 for the 350 kW motor, the wheelset
behind its gear included."""
ROTATING_SHARE: Final = 0.08
ROTATING_FLOOR: Final = 0.02
"""And never more than this share of the load, plus a hill's part per unit of rated torque: what
turns is a few percent of a train's inertia. All wheels that run away together need more. Against
the effort there is only the hill."""
SINGLE_CREDIT: Final = 0.05
"""Per unit of rated torque: a drive without others that accelerates by more may be running away."""
SINGLE_CHANGE: Final = 0.3
"""And one that is so far from its own speed of late, as a share of it; a train of 1 m/s^2 is beyond
1.7 m/s when it is not."""
LEAST_SPEED_RAD_S: Final = 3.0
"""At the rotor; below it a share of the speed says nothing."""
SPEEDS_APART: Final = 0.05
SPEEDS_APART_RAD_S: Final = 1.0
"""A speed by the currents that differs by more from `Motion`, at the rotor, is no measure for
others; `Motion` is up to 10 ms old."""
TURNS_RAD_S: Final = 1.0
"""From this speed on, its sign is no noise."""
FOLLOWED_S: Final = 0.2
"""A speed by the currents that has been followed for less may be on its way from a guess: beyond
`LEARN_CREEP` from it, `Motion` goes before it."""
MOST_CREEP: Final = 0.08
"""Of a rotor against the others, which creep by one or two percent themselves: together 10 %."""
MOST_APART: Final = 0.1
"""The same while its diameter is not known yet, diameters included."""
NEAR_S: Final = 0.1
"""A rotor that was further away is back after so long: one that turns backwards passes by."""
SLIDES_S: Final = 0.2
"""A rotor that is apart and carries more than the others for so long slides under its load; one
that loses or finds its grip is sooner through."""
GRIPS: Final = 0.1
"""Per unit of rated torque that one which has run away carries more than the others: at once."""
ALONE_S: Final = 0.15
"""A rotor that all others have left is held against its own speed of late for so long: what it
could lose or gain meanwhile is within `LEARN_CREEP`."""
AGAINST: Final = 0.25
"""Share of the others' load that one which is apart carries against them: it turns backwards."""
LEARN_CREEP: Final = 0.03
STEADY: Final = 0.02
"""Diameters are learnt while a rotor is no further than this from where it is expected."""
DIAMETER_FIRST_S: Final = 3.0
"""Of adhering; until then any diameter is expected."""
DIAMETER_TAU_S: Final = 60.0
"""Then so slowly: a slip that grows over seconds is no diameter."""
MOST_DIAMETER: Final = 0.06
UNCOMMANDED: Final = 0.12
UNCOMMANDED_RELATIVE: Final = 0.15
"""A load beyond the command, per unit of rated torque and of the command, that no motor data off
their sheet explain."""
COMMAND_LATE_S: Final = 0.3
"""For so long: a command is up to 0.1 s old, and a drive follows it with a ramp of its own."""
FACTOR: Final = 2.0
FACTOR_FLOOR: Final = 0.1
"""A command is odd beyond this factor from the median of the others and 0.1 of rated torque."""
LOAD_NEAR: Final = 0.25
LOAD_NEAR_FLOOR: Final = 0.05
"""While its load is this near to the median of the others: relative, per unit of rated torque."""
ODD_S: Final = 0.15
MOST_COMMAND: Final = 3.0
"""Per unit of rated torque; no drive delivers more."""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


class Train(NamedTuple):
    """Memory of N drives, (N,), NaN where a number is not known.

    rated Nm, inertia kg m2, motor: the first with the same ratings; slow_speed, quick_speed:
    smoothed speed of the rotor, rad/s; taken: what accelerates it with its train, per unit of rated
    torque; braked: more of it, if friction brakes slow the train; diameter: of the wheel over the
    others', as speeds, learnt for learnt_s; creep: as last found; followed_s: for how long its
    currents have been followed; alone_s: for how long all others have been away; far: beyond
    `MOST_APART` while diameters are not known; apart: beyond `MOST_CREEP` when that was last known,
    near_s: for how long it has not been, slides_s: for how long it has carried more than the others
    meanwhile; away: left the others for the side that the effort takes it to, and is not back yet;
    uncertain: it may be running away, or braked by something else; doubt_ns: until then its
    currents accuse nobody; uncommanded_s, odd_s: for how long, odd: too long; above: carries more
    than its command and than the others, in this tick; speed, load: of one tick; train: its speed;
    way: sign of a rotor's speed when it adhered, 0 if unknown (given); forward: sign of its speed
    when it last turned; before that it pulls.
    """

    rated: Array
    inertia: Array
    motor: Ints
    slow_speed: Array
    quick_speed: Array
    taken: Array
    braked: Array
    diameter: Array
    learnt_s: Array
    creep: Array
    followed_s: Array
    alone_s: Array
    far: Flags
    apart: Flags
    near_s: Array
    slides_s: Array
    away: Flags
    uncertain: Flags
    doubt_ns: Ints
    uncommanded_s: Array
    odd_s: Array
    odd: Flags
    above: Flags
    speed: Array
    load: Array
    train: train_speed.TrainSpeed
    way: Ints
    forward: Ints


def start(motors: Sequence[Motor]) -> Train:
    """Nothing known. Speeds are compared between drives whose motors have the same ratings.

    What was measured on each motor, such as its flux, may differ.
    """
    n = len(motors)
    ratings = [(m.pole_pairs, m.T_rated, m.I_rated) for m in motors]
    unknown = np.full((5, n), np.nan)
    far, apart, away, uncertain, odd, above = np.zeros((6, n), dtype=np.bool_)
    doubt_ns = np.full(n, NEVER, dtype=np.int64)
    return Train(
        np.array([m.T_rated for m in motors]), np.array([m.J for m in motors]),
        np.array([ratings.index(m) for m in ratings], dtype=np.int64), unknown[0],
        unknown[4], np.zeros(n), np.zeros(n), np.ones(n), np.zeros(n), unknown[1], np.zeros(n),
        np.zeros(n), far, apart, np.zeros(n), np.zeros(n), away, uncertain, doubt_ns, np.zeros(n),
        np.zeros(n), odd, above, unknown[2], unknown[3], train_speed.start(n),
        np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64),
    )  # fmt: skip


def middle(numbers: Array, upper: bool) -> float:
    """Median; of an even number the upper or the lower of the two; NaN of none."""
    count = len(numbers)
    if count == 0:
        return math.nan
    return float(np.sort(numbers)[count // 2 if upper else (count - 1) // 2])


def _others(k: int, tracked: bool, upper: bool, train: Train) -> float:
    """Median speed of the other drives with the same motor, the `tracked` ones only or all.

    NaN without any.
    """
    compared = (train.motor == train.motor[k]) & ~np.isnan(train.speed)
    if tracked:
        compared &= ~np.isnan(train.load)
    compared[k] = False
    return middle(train.speed[compared], upper)


def _note(measured: Array, now: int, tick_s: float, told: Told, train: Train) -> list[float]:
    """Speeds and loads of this tick; the loads that are known, in the train's direction."""
    loads = []
    for k in range(measured.shape[0]):
        tracking, speed = told.health[k] == Health.TRACKING, measured[k]
        train.load[k] = math.nan
        train.followed_s[k] = train.followed_s[k] + tick_s if tracking else 0.0
        if tracking:
            # Where the two speeds differ, neither is a measure for others.
            off = abs(speed - told.speed[k])
            apart = off > SPEEDS_APART * abs(speed) + SPEEDS_APART_RAD_S
            young = train.followed_s[k] < FOLLOWED_S or now < train.doubt_ns[k]
            guess = young and off > LEARN_CREEP * abs(speed)
            if apart:
                speed = math.nan
            elif not guess:
                speed = told.speed[k]
            if abs(told.speed[k]) >= TURNS_RAD_S:
                train.forward[k] = -1 if told.speed[k] < 0.0 else 1
            pulls = -1 if told.load[k] < 0.0 else 1
            train.load[k] = (train.forward[k] or pulls) * told.load[k] / train.rated[k]
            loads.append(float(train.load[k]))
        train.speed[k] = speed
    return loads


def _accelerate(tick_s: float, braking: bool, train: Train) -> None:
    """What every rotor takes to follow the median of all, per unit of its rated torque."""
    smoothed = (train.slow_speed, ACCELERATION_TAU_S), (train.quick_speed, BRAKE_TAU_S)
    middles = []
    for kept, tau_s in smoothed:
        rates = []
        for k in range(train.speed.shape[0]):
            speed = train.speed[k]
            if math.isnan(speed):
                # Beside `Motion` that is apart the drive is still followed.
                if math.isnan(train.load[k]):
                    kept[k] = math.nan
                continue
            slow = speed if math.isnan(kept[k]) else kept[k]
            kept[k] = slow + tick_s / tau_s * (speed - slow)
            if abs(slow) >= LEAST_SPEED_RAD_S:
                # Relative, so that it is the same for all diameters and gears.
                rates.append((speed - slow) / tau_s / slow)
        known = np.array([rate for rate in rates if not math.isnan(rate)])
        middles.append((middle(known, braking), len(known)))
    (rate, count), (quick, _) = middles
    for k in range(train.speed.shape[0]):
        load = 0.0 if math.isnan(train.load[k]) else abs(train.load[k])
        helped = (rate > 0.0) == (train.load[k] > 0.0)
        most = ROTATING_FLOOR + (ROTATING_SHARE * load if helped else 0.0)
        own = _torque_of(train, k, rate, train.slow_speed[k])
        train.taken[k] = min(max(own, -most), most)
        credit = _torque_of(train, k, quick, train.quick_speed[k])
        train.braked[k] = credit - train.taken[k] if braking and quick < 0.0 else 0.0
        train.uncertain[k] = count < 2 and (
            abs(own) > SINGLE_CREDIT or abs(rate) * ACCELERATION_TAU_S > SINGLE_CHANGE
        )


def _torque_of(train: Train, k: int, rate: float, speed: float) -> float:
    torque = train.inertia[k] * rate * speed / train.rated[k]
    if math.isnan(torque):
        return 0.0
    return float(min(max(torque, -MOST_ACCELERATION_TORQUE), MOST_ACCELERATION_TORQUE))


def _own_change(k: int, train: Train) -> float:
    """By what share rotor k is faster than it was of late."""
    return float(train.speed[k] * train.diameter[k] / abs(train.slow_speed[k]) - 1.0)


def _stays(k: int, tick_s: float, train: Train) -> bool:
    """Whether all other wheels have left that of drive k just now, and it is as fast as before."""
    others, away = 0, 0
    for j in range(train.speed.shape[0]):
        if j != k and train.motor[j] == train.motor[k] and not math.isnan(train.speed[j]):
            others += 1
            away += train.away[j]
    alone = others > 0 and away == others
    train.alone_s[k] = train.alone_s[k] + tick_s if alone else 0.0
    kept = abs(_own_change(k, train)) <= LEARN_CREEP
    return bool(0.0 < train.alone_s[k] <= ALONE_S and kept)


def _slip(k: int, effort: float, train: Train) -> float:
    """Against the train or against the others, whichever is more of what is known."""
    return float(np.fmax(effort * train.creep[k], train.train.slip[k]))


def _runs_away(k: int, effort: float, train: Train) -> bool:
    """Whether drive k's wheel has left the others for the side that the effort takes it to.

    It has where its own speed has changed, not theirs; until it is back. effort: 1, braking -1.
    """
    slip = _slip(k, effort, train)
    if train.away[k]:
        return bool(slip > LEARN_CREEP)
    return bool(slip > MOST_CREEP and effort * _own_change(k, train) > LEARN_CREEP)


def _speed_of_others(k: int, braking: bool, train: Train) -> float:
    """Median speed of the others that are followed, else of all; NaN without any."""
    others = _others(k, True, braking, train)
    return _others(k, False, braking, train) if math.isnan(others) else others


def _learn_diameters(tick_s: float, flag: Ints, operating: Flags, train: Train) -> None:
    """What is left between the speeds of wheels that adhere, while none is lost."""
    lost = False
    for k in range(flag.shape[0]):
        # A drive that is cut out keeps its flag, and stops nobody from learning.
        lost = lost or (flag[k] == Flag.BAD and operating[k])
    for k in range(flag.shape[0]):
        near = LEARN_CREEP
        if train.learnt_s[k] < train_speed.ROUGH_S:
            near += MOST_DIAMETER
        if lost or flag[k] != Flag.GOOD or not abs(train.creep[k]) <= near:
            continue
        wanted = train.diameter[k] * (1.0 + train.creep[k])
        wanted = min(max(wanted, 1.0 - MOST_DIAMETER), 1.0 + MOST_DIAMETER)
        train.learnt_s[k] += tick_s
        tau = min(max(train.learnt_s[k], 10.0 * tick_s), DIAMETER_TAU_S)
        train.diameter[k] += tick_s / tau * (wanted - train.diameter[k])


def _others_slide(k: int, flag: Ints, train: Train) -> bool:
    """Whether of drive k's motor all others, one at least, have run away and are flagged for it."""
    others = [
        j for j in np.flatnonzero(train.motor == train.motor[k])
        if j != k and not math.isnan(train.speed[j])
    ]  # fmt: skip
    return not train.away[k] and bool(others) and all(
        train.away[j] and flag[j] == Flag.BAD for j in others
    )  # fmt: skip


def _compare_speeds(
    tick_s: float, braking: bool, effort: float, flag: Ints, operating: Flags, train: Train
) -> None:
    """Who turns faster or slower than the others; learns diameters while nobody slips."""
    for k in range(flag.shape[0]):
        speed = train.speed[k]
        train.speed[k] = train.way[k] * speed if train.way[k] else abs(speed)
    for k in range(flag.shape[0]):
        train.far[k] = False
        if train.learnt_s[k] < DIAMETER_FIRST_S:
            # What has been learnt so far may be a slip that grows.
            others = _speed_of_others(k, braking, train)
            creep = train.speed[k] / others - 1.0 if others >= LEAST_SPEED_RAD_S else 0.0
            train.far[k] = abs(creep) > MOST_APART
    for k in range(flag.shape[0]):
        train.speed[k] /= train.diameter[k]
    memory = train.train
    train_speed.follow(
        memory, train.motor, train.speed, train.load, flag, (flag == Flag.BAD) & operating,
        train.apart, train.rated, train.inertia, train.learnt_s, effort, braking, tick_s,
    )  # fmt: skip
    for k in range(flag.shape[0]):
        others = _speed_of_others(k, braking, train)
        train.creep[k] = math.nan
        if others >= LEAST_SPEED_RAD_S and not math.isnan(train.speed[k]):
            train.creep[k] = train.speed[k] / others - 1.0
        if not math.isnan(train.creep[k]) or not math.isnan(memory.slip[k]):
            train.away[k] = _runs_away(k, -1.0 if braking else 1.0, train)
        turned = train.away[k] and train.learnt_s[k] >= train_speed.ROUGH_S
        memory.sliding[k] = turned and memory.sliding_s[k] > train_speed.SLIDING_S
    for k in range(flag.shape[0]):
        stays = _stays(k, tick_s, train)
        train.far[k] = train.far[k] and not _others_slide(k, flag, train)
        train.uncertain[k] = train.uncertain[k] or (train.far[k] and not stays)
        slip = memory.slip[k]
        if math.isnan(train.creep[k]) and math.isnan(slip):
            # Nobody sees whether it is back.
            train.uncertain[k] = train.uncertain[k] or train.apart[k]
            continue
        far = train_speed.is_off(memory, k, train.learnt_s[k])
        far = far or _slip(k, -1.0 if braking else 1.0, train) > MOST_CREEP
        beyond = (abs(train.creep[k]) > MOST_CREEP if math.isnan(slip) else far) and not stays
        train.near_s[k] = 0.0 if beyond else train.near_s[k] + tick_s
        train.apart[k] = train.near_s[k] == 0.0 or (train.apart[k] and train.near_s[k] < NEAR_S)
        train.uncertain[k] = train.uncertain[k] or beyond
    _learn_diameters(tick_s, flag, operating, train)


def _uncommanded(k: int, tick_s: float, slow: SlowState, told: Told, train: Train) -> bool:
    """Whether drive k has carried what it was not asked for, for too long."""
    load = told.load[k] / train.rated[k] + train.taken[k]
    sign = 1.0 if load >= 0.0 else -1.0
    asked = max(sign * slow.command[k], sign * slow.before[k], 0.0) / train.rated[k]
    beyond = sign * load > asked + UNCOMMANDED + UNCOMMANDED_RELATIVE * asked
    train.uncommanded_s[k] = train.uncommanded_s[k] + tick_s if beyond else 0.0
    return bool(train.uncommanded_s[k] > COMMAND_LATE_S)


def _others_load(k: int, train: Train) -> float:
    """Median load of the other drives, per unit; NaN without any."""
    compared = ~np.isnan(train.load)
    compared[k] = False
    return middle(train.load[compared], False)


def _like_others(k: int, train: Train) -> bool:
    """Whether drive k's load is near the median of the other drives'; false without any."""
    load = _others_load(k, train)
    return bool(abs(train.load[k] - load) <= LOAD_NEAR * abs(load) + LOAD_NEAR_FLOOR)


def _slides(k: int, flag: int, tick_s: float, train: Train) -> bool:
    """Whether drive k's wheel slides under its load: no measure for those that hold.

    Nor is one that turns backwards; but a lost one that carries more is one that grips again.
    """
    load, others = train.load[k], _others_load(k, train)
    more = train.apart[k] and flag != Flag.BAD and abs(load) > abs(others)
    train.slides_s[k] = train.slides_s[k] + tick_s if more else 0.0
    against = train.apart[k] and load * others < -AGAINST * others * others
    grips = train.away[k] and more and abs(load) > abs(others) + GRIPS
    return bool(train.slides_s[k] > SLIDES_S or against or grips)


def _odd_command(k: int, tick_s: float, slow: SlowState, commanded: Flags, train: Train) -> bool:
    """Whether drive k's command is far from the others' although its load is like theirs."""
    own = abs(slow.command[k]) / train.rated[k]
    compared = commanded.copy()
    compared[k] = False
    others = middle(np.abs(slow.command[compared]) / train.rated[compared], False)
    # Written so that what is not known is not odd.
    far = own > FACTOR * others + FACTOR_FLOOR or own < others / FACTOR - FACTOR_FLOOR
    train.odd_s[k] = train.odd_s[k] + tick_s if far and _like_others(k, train) else 0.0
    return bool(train.odd_s[k] > ODD_S or own > MOST_COMMAND)


def _is_withdrawn(k: int, flag: Ints, slow: SlowState, train: Train) -> bool:
    """Whether a drive that was flagged is off, and turns along with a wheel that adheres or at
    constant speed."""
    if slow.operating[k] or flag[k] != Flag.BAD or train.apart[k]:
        return False
    beside = any(flag[j] == Flag.GOOD for j in range(flag.shape[0]) if j != k)
    mean = abs(train.slow_speed[k])
    goes_on = abs(train.speed[k] * train.diameter[k] - mean) <= STEADY * mean
    return bool((beside or goes_on) and abs(train.creep[k]) <= LEARN_CREEP)


def _unjudged(k: int, health: int, reason: int, told: Told) -> None:
    told.health[k], told.reason[k] = health, reason
    told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan


def assess_train(
    measured: Array, commanded: Flags, slow: SlowState, flag: Ints, now: int, tick_s: float,
    told: Told, train: Train,
) -> list[bool]:  # fmt: skip
    """Once a tick, after the estimates and before they are compared; see `train`.

    measured (N,): rotor speeds of fresh `Motion`, rad/s, NaN without; flag (N,): adhesion flags so
    far. Changes commanded (N,), false where a command cannot be believed, and `told` of drives that
    are not judged. Returned, (N,): drives whose flag is withdrawn: they are off, and roll along.
    """
    loads = _note(measured, now, tick_s, told, train)
    braking, effort = sum(loads) < 0.0, abs(sum(loads)) / max(len(loads), 1)
    _accelerate(tick_s, braking, train)
    _compare_speeds(tick_s, braking, effort, flag, slow.operating, train)
    for k in range(flag.shape[0]):
        train.above[k] = False
        if not commanded[k] or told.health[k] != Health.TRACKING:
            train.uncommanded_s[k] = 0.0
        elif slow.operating[k] and _uncommanded(k, tick_s, slow, told, train):
            commanded[k] = False
            _unjudged(k, Health.INPUT_INVALID, Reason.RANGE, told)
        else:
            above = train.uncommanded_s[k] > 0.0 and not _like_others(k, train)
            slides = _slides(k, flag[k], tick_s, train)
            train.above[k] = above or slides
    for k in range(flag.shape[0]):
        train.odd[k] = commanded[k] and _odd_command(k, tick_s, slow, commanded, train)
    withdrawn = [_is_withdrawn(k, flag, slow, train) for k in range(flag.shape[0])]
    for k in range(flag.shape[0]):
        commanded[k] = commanded[k] and not train.odd[k]
        if not slow.operating[k] and told.health[k] != Health.INPUT_INVALID:
            _unjudged(k, Health.UNKNOWN, Reason.NOT_AVAILABLE, told)
    return withdrawn
