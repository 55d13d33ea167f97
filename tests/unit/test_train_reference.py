"""`train.c` and `rotors.c` against Python: any speeds, loads and commands, held for a while."""

from types import SimpleNamespace

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import ROTOR, ROTOR_INPUTS, pointer
from gateway.core.codes import Flag, Health
from gateway.settings.config import BENCH_MOTOR
from tests import columns
from tests.reference import train as reference
from tests.same import same_numbers

TICK_S = 0.01
OTHER = BENCH_MOTOR.model_copy(update={"T_rated": 2.0 * BENCH_MOTOR.T_rated})
SAME = {
    "slow_speed": "slow_speed", "quick_speed": "quick_speed",
    "taken": "acceleration_torque", "braked": "brake_torque", "diameter": "diameter",
    "learnt_s": "learnt_s", "creep": "creep", "followed_s": "followed_s", "alone_s": "alone_s",
    "far": "far", "apart": "apart", "near_s": "near_s", "slides_s": "slides_s", "away": "away",
    "uncertain": "uncertain", "doubt_ns": "unreliable_until_ns", "uncommanded_s": "uncommanded_s",
    "odd_s": "odd_s", "odd": "odd", "above": "above", "speed": "speed", "load": "load",
    "rated": "rated_nm", "inertia": "inertia_kg_m2", "motor": "motor", "forward": "forward",
}  # fmt: skip
"""Field of the reference: field of `struct rotor`."""
HEALTH = [Health.TRACKING] * 8 + [Health.CONVERGING, Health.INPUT_INVALID]


def started(plain):
    """`struct rotor` of the same ratings as in the reference, of which nothing is known."""
    rotors = np.zeros(len(plain.rated), ROTOR)
    rotors["rated_nm"], rotors["inertia_kg_m2"] = plain.rated, plain.inertia
    rotors["motor"] = plain.motor
    lib.train_reset(pointer("struct rotor", rotors), len(rotors))
    return rotors


def assess_train(measured, commanded, slow, flag, now, told, rotors, tick_s=TICK_S):
    """`assess_train` of the core; changes what the reference changes."""
    n = len(rotors)
    one = np.zeros(n, ROTOR_INPUTS)
    one["measured_rad_s"], one["speed_rad_s"], one["load_nm"] = measured, told.speed, told.load
    one["health"], one["operating"], one["adhesion"] = told.health, slow.operating, flag
    one["command_nm"], one["previous_command_nm"] = slow.command, slow.before
    one["command_valid"] = commanded
    lib.assess_train(
        pointer("struct rotor", rotors), pointer("struct rotor_inputs", one), n, now, tick_s,
        pointer("double", np.zeros(2 * n)),
    )  # fmt: skip
    commanded[:] = one["command_valid"]
    gone = one["not_judged"] == 1
    told.health[gone], told.reason[gone] = one["health"][gone], one["health_reason"][gone]
    for column in (told.speed, told.load, told.sigma, told.nis):
        column[gone] = np.nan
    return one["withdrawn"].tolist()


def same(rotors, plain):
    for field, name in SAME.items():
        same_numbers(rotors[name], getattr(plain, field), name)
    train = plain.train
    for name, wanted in zip(("train_speed", "train_limit"), train.bounds, strict=True):
        same_numbers(rotors[name], wanted, name)
    for name in ("unseen_s", "slip", "sliding_s", "sliding", "ahead_s"):
        same_numbers(rotors[name], getattr(train, name), name)


def drawn(rng, n, level):
    """One situation: what drives show, until the next one."""
    share = rng.choice([1.0, 1.0, 1.0, 0.5, 0.0, -0.4, 1.3], n)
    return SimpleNamespace(
        creep=rng.choice([0.0, 0.0, 0.01, -0.02, 0.05, 0.09, 0.3, -0.12, -2.0], n),
        drift=rng.choice([0.0, 0.0, 0.0, 0.5, -0.3], n),
        command=level * rng.choice([1.0, 1.0, 1.0, 0.3, 4.0, 0.0], n), share=share,
        before=rng.choice([1.0, 1.0, 0.5, 1.5], n),
        health=rng.choice(HEALTH, n), measured=rng.random(n) < 0.8,
        commanded=rng.random(n) < 0.9, operating=rng.random(n) < 0.9,
        flag=rng.choice([Flag.GOOD, Flag.GOOD, Flag.GOOD, Flag.BAD, Flag.UNKNOWN], n),
        off=rng.choice([0.0, 0.0, 0.0, 0.0, 0.04, 0.4], n),
        ticks=int(rng.choice([1, 5, 20, 60, 350])),
    )  # fmt: skip


def course(seed, n, ticks, step):
    """What `assess_train` is given, tick by tick: anything, but mostly a train that drives.

    step: that numbers are rounded to, so that some are equal and zeros have both signs; or 0.
    """
    rng = np.random.default_rng(seed)
    diameter = rng.uniform(0.97, 1.03, n)
    left, speed = 0, 25.0
    for tick in range(ticks):
        if not left:
            level = rng.choice([0.0, 3.0, 20.0, -20.0, 28.0])
            now, rate = drawn(rng, n, level), rng.choice([0.0, 2.0, -2.0, 12.0])
            left = now.ticks
        left -= 1
        speed = min(max(speed + rate * TICK_S, -10.0), 90.0)
        now.creep += now.drift * TICK_S
        true = speed * diameter * (1.0 + now.creep)
        told, sent = columns.told(n), columns.slow(n)
        told.health[:] = now.health
        told.speed[:] = true * (1.0 + now.off) + rng.normal(0.0, 0.02, n)
        told.load[:] = now.command * now.share + rng.normal(0.0, 0.3, n)
        told.sigma[:], told.nis[:] = 0.5, 1.0
        sent.command[:], sent.before[:] = now.command, now.command * now.before
        sent.before[rng.random(n) < 0.02] = np.nan
        sent.operating[:] = now.operating
        measured = np.where(now.measured, true + rng.normal(0.0, 0.05, n), np.nan)
        for column in (told.speed, told.load, measured):
            column[:] = np.round(column / step) * step if step else column
        if tick % 97 == 5:
            told.speed[rng.integers(n)] = rng.choice([np.nan, 0.0, np.inf])
            told.load[rng.integers(n)] = rng.choice([np.nan, 1e308, -np.inf])
            measured[rng.integers(n)] = rng.choice([0.0, np.inf, -true[0]])
        yield measured, now.commanded.copy(), sent, now.flag.astype(np.int64), told


def copied(given):
    measured, commanded, sent, flag, told = given
    again = columns.told(len(flag))
    again.estimates[:] = told.estimates
    return measured.copy(), commanded.copy(), sent, flag, again


@pytest.mark.parametrize(
    ("n", "ticks", "step"),
    [
        *((n, 2000, 0.0) for n in (1, 2, 3)), *((n, 800, 0.5) for n in (2, 16)), (65, 300, 0.5),
        *(pytest.param(*one, marks=pytest.mark.thorough)
          for one in ((5, 2000, 0.0), (1, 800, 0.5), (3, 800, 0.5), (64, 300, 0.0))),
    ],
)  # fmt: skip
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.thorough)])
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_any_course_of_a_train(seed, n, ticks, step):
    motors = [BENCH_MOTOR] * n if seed else [BENCH_MOTOR, OTHER] * n
    motors = motors[:n]
    plain = reference.start(motors)
    rotors = started(plain)
    same(rotors, plain)
    # Diameters of which little is known, or just enough; and all that a minute teaches.
    plain.learnt_s[:] = rotors["learnt_s"] = np.resize(((0.0, 3.0, 59.95), (59.0,))[seed], n)
    plain.far[:] = rotors["far"] = True
    names = ("far", "apart", "away", "uncertain", "odd", "above", "withdrawn")
    met = {name: set() for name in names}
    doubt = np.random.default_rng(seed)
    for now, given in enumerate(course(seed, n, ticks, step)):
        measured, commanded, sent, flag, told = given
        again = copied(given)
        if now % 50 == 0:
            # In ticks, of one nanosecond here.
            plain.doubt_ns[:] = now + doubt.integers(0, 30, n)
            rotors["unreliable_until_ns"] = plain.doubt_ns
            plain.way[:] = rotors["way"] = doubt.choice([0, 1, 1, 1, -1], n)
            # From these times on a diameter is known to a percent, or known.
            one = doubt.integers(n)
            plain.learnt_s[one] = rotors["learnt_s"][one] = doubt.choice([0.5, 3.0])
        withdrawn = reference.assess_train(
            measured, commanded, sent, flag, now, TICK_S, told, plain
        )
        assert assess_train(*again[:4], now, again[4], rotors) == withdrawn
        met["withdrawn"] |= set(withdrawn)
        same(rotors, plain)
        np.testing.assert_array_equal(again[1], commanded)
        same_numbers(again[4].estimates, told.estimates)
        for name in met.keys() - {"withdrawn"}:
            met[name] |= set(rotors[name].tolist())
    if n > 3:
        assert sum(states == {0, 1} for states in met.values()) > 5, met


def test_drives_that_are_off_keep_their_flags_until_their_speed_is_constant():
    """Two that turn alike while they speed up: nothing shows that either of them adheres."""
    plain = reference.start([BENCH_MOTOR] * 2)
    rotors = started(plain)
    flag, speed, withdrawn = np.array([Flag.BAD] * 2), 25.0, []
    for now in range(800):
        speed += 12.0 * TICK_S if now < 200 else 0.0
        told, slow = columns.told(2), columns.slow(2)
        told.health[:], told.speed[:], told.load[:] = Health.TRACKING, speed, 0.0
        slow.operating[:] = False
        given = np.full(2, speed), np.ones(2, dtype=bool), slow, flag, told
        again = copied(given)
        withdrawn.append(assess_train(*again[:4], now, again[4], rotors))
        wanted = reference.assess_train(*given[:4], now, TICK_S, told, plain)
        assert withdrawn[-1] == wanted
    assert withdrawn[100:200] == [[0, 0]] * 100
    assert withdrawn[-1] == [1, 1]


LIMITS = (0.0, 0.05, 0.1, 0.12, 0.2, 0.25, 0.27, 0.3, 0.35, 0.375, 0.5, 1.0, 1.25, 1.27, 2.1, 3.0)
"""Per unit: what loads and commands are compared with, and sums of it."""


@pytest.mark.parametrize(
    ("n", "tick_s", "ticks", "speeds", "lost"),
    [
        (3, 0.01, 1400, [1.0], 0.0), (3, 0.15, 300, [1.0], 0.0),
        (3, 0.1, 600, [5.0, 5.0, 6.0], 0.0),
        (2, 0.1, 600, [3.0, 3.0, 3.12, 5.0, 5.2], 0.3), (1, 0.1, 600, [40.0, 44.0, 41.0], 0.0),
    ],
)  # fmt: skip
def test_loads_commands_speeds_and_times_on_their_limits(n, tick_s, ticks, speeds, lost):
    """Of motors with 1 Nm, and ticks that fill a time exactly; lost: share of unknown estimates."""
    rng = np.random.default_rng(0)
    motors = [BENCH_MOTOR.model_copy(update={"T_rated": 1.0})] * n
    plain = reference.start(motors)
    rotors, met = started(plain), {name: set() for name in ("odd", "above", "uncommanded_s")}
    for now in range(ticks):
        if now % (1 + round(0.35 / tick_s)) == 0:
            loads, commands = rng.choice(LIMITS, n), rng.choice([0.0, 0.1, 0.2, 1.0, 3.0], n)
            if rng.random() < 0.5:
                loads[:] = loads[0]
            speed, measured = rng.choice(speeds, (2, n))
            tracking = rng.random(n) >= lost
        told, sent = columns.told(n), columns.slow(n)
        told.health[:], told.load[:] = np.where(tracking, Health.TRACKING, Health.CONVERGING), loads
        told.speed[:] = speed
        sent.command[:] = sent.before[:] = commands
        sent.operating[:] = True
        given = measured.copy(), np.ones(n, dtype=bool), sent, np.full(n, Flag.GOOD, np.int64), told
        again = copied(given)
        reference.assess_train(*given[:4], now, tick_s, told, plain)
        assess_train(*again[:4], now, again[4], rotors, tick_s)
        same(rotors, plain)
        np.testing.assert_array_equal(again[1], given[1])
        same_numbers(again[4].estimates, told.estimates)
        for name, states in met.items():
            states |= set((rotors[name] > 0).tolist())
    if n > 1:
        assert all(states == {False, True} for states in met.values()), met


def test_what_lies_behind_the_drives_is_left_alone():
    """Room for three, of which two are in use."""
    rotors, given = started(reference.start([BENCH_MOTOR] * 3)), np.zeros(3, ROTOR_INPUTS)
    given["measured_rad_s"] = given["speed_rad_s"] = 20.0
    given["health"], given["adhesion"], given["command_valid"] = Health.TRACKING, Flag.GOOD, 1
    given["command_nm"] = given["load_nm"] = 5.0 * BENCH_MOTOR.T_rated
    rotors["creep"] = 0.01
    before = rotors[2].tobytes(), given[2].tobytes()
    lib.assess_train(
        pointer("struct rotor", rotors), pointer("struct rotor_inputs", given), 2, 0, TICK_S,
        pointer("double", np.zeros(4)),
    )  # fmt: skip
    assert (rotors[2].tobytes(), given[2].tobytes()) == before
    assert rotors["odd"].tolist() == [1, 1, 0]
    assert given["command_valid"].tolist() == [0, 0, 1]


@pytest.mark.parametrize(("flags", "steady", "expected"), [
    ([Flag.GOOD, Flag.BAD], False, [0, 1]),
    ([Flag.BAD, Flag.GOOD], False, [1, 0]),
    ([Flag.UNKNOWN, Flag.BAD], False, [0, 0]),
    ([Flag.BAD, Flag.BAD], False, [0, 0]),
    ([Flag.BAD, Flag.BAD], True, [1, 1]),
])  # fmt: skip
def test_a_flag_is_withdrawn_beside_a_wheel_that_adheres_or_at_constant_speed(
    flags, steady, expected
):
    """Of two drives that are off; in the room behind them one adheres."""
    rotors, given = started(reference.start([BENCH_MOTOR] * 3)), np.zeros(3, ROTOR_INPUTS)
    given["measured_rad_s"] = given["speed_rad_s"] = 20.0
    given["health"], given["adhesion"] = Health.TRACKING, [*flags, Flag.GOOD]
    rotors["followed_s"], rotors["slow_speed"] = 1.0, 20.0 if steady else 30.0
    rotors["near_s"] = 1.0
    lib.assess_train(
        pointer("struct rotor", rotors), pointer("struct rotor_inputs", given), 2, 0, TICK_S,
        pointer("double", np.zeros(4)),
    )  # fmt: skip
    assert given["withdrawn"].tolist() == [*expected, 0]
    assert given["not_judged"].tolist() == [1, 1, 0]


def test_a_load_that_is_no_evidence_leaves_a_loss_undecided():
    rotor, given = started(reference.start([BENCH_MOTOR])), np.zeros(1, ROTOR_INPUTS)
    pointers = pointer("struct rotor", rotor), pointer("struct rotor_inputs", given)
    assert lib.limit_loss(*pointers, 0.9, 0) == 0.9
    assert rotor["uncertain"][0] == 0
    given["may_be_off"] = 1
    assert lib.limit_loss(*pointers, lib.UNDECIDED, 0) == lib.UNDECIDED
    assert rotor["uncertain"][0] == 0
    assert lib.limit_loss(*pointers, 0.9, 0) == lib.UNDECIDED
    assert rotor["uncertain"][0] == 1
