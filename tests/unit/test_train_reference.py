"""`train.c` and `rotors.c` against Python: any speeds, loads and commands, held for a while."""

from types import SimpleNamespace

import numpy as np
import pytest

from gateway import slow, tracks, train
from gateway._train_kernels import assess_train
from gateway.config import BENCH_MOTOR
from gateway.health import NEVER, Flag, Health
from tests.reference import train as reference

TICK_S = 0.01
OTHER = BENCH_MOTOR.model_copy(update={"T_rated": 2.0 * BENCH_MOTOR.T_rated})
SAME = {
    "slow_speed": "slow_speed", "taken": "acceleration_torque", "diameter": "diameter",
    "learnt_s": "learnt_s", "creep": "creep", "followed_s": "followed_s", "alone_s": "alone_s",
    "far": "far", "apart": "apart", "near_s": "near_s", "slides_s": "slides_s", "away": "away",
    "uncertain": "uncertain", "doubt_ns": "doubt_until_ns", "uncommanded_s": "uncommanded_s",
    "odd_s": "odd_s", "odd": "odd", "above": "above", "speed": "speed", "load": "load",
    "rated": "rated_nm", "inertia": "inertia_kg_m2", "motor": "motor",
}  # fmt: skip
"""Field of the reference: field of `struct rotor`."""
HEALTH = [Health.TRACKING] * 8 + [Health.CONVERGING, Health.INPUT_INVALID]


def same(rotors, plain):
    for field, name in SAME.items():
        np.testing.assert_array_equal(rotors[name], getattr(plain, field), name)


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


def course(seed, n, ticks):
    """What `assess_train` is given, tick by tick: anything, but mostly a train that drives."""
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
        told, sent = tracks.told(n), slow.start(n)
        told.health[:] = now.health
        told.speed[:] = true * (1.0 + now.off) + rng.normal(0.0, 0.02, n)
        told.load[:] = now.command * now.share + rng.normal(0.0, 0.3, n)
        told.sigma[:], told.nis[:] = 0.5, 1.0
        sent.command[:], sent.before[:] = now.command, now.command * now.before
        sent.before[rng.random(n) < 0.02] = np.nan
        sent.operating[:] = now.operating
        measured = np.where(now.measured, true + rng.normal(0.0, 0.05, n), np.nan)
        if tick % 97 == 5:
            told.speed[rng.integers(n)] = rng.choice([np.nan, 0.0, np.inf])
            told.load[rng.integers(n)] = rng.choice([np.nan, 1e308, -np.inf])
            measured[rng.integers(n)] = rng.choice([0.0, np.inf, -true[0]])
        yield measured, now.commanded.copy(), sent, now.flag.astype(np.int64), told


def copied(given):
    measured, commanded, sent, flag, told = given
    return (measured.copy(), commanded.copy(), sent, flag, tracks.Told(*(c.copy() for c in told)))


@pytest.mark.parametrize("n", [1, 2, 3, 5])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_any_course_of_a_train(seed, n):
    motors = [BENCH_MOTOR] * n if seed else [BENCH_MOTOR, OTHER] * n
    motors = motors[:n]
    plain, kept = reference.start(motors), train.start(motors)
    same(kept.rotors, plain)
    # Diameters of which little is known, and nearly all, of which one learns a minute.
    plain.learnt_s[:] = kept.rotors["learnt_s"] = (0.0, 59.0)[seed]
    met = {name: set() for name in ("far", "apart", "away", "uncertain", "odd", "above")}
    doubt = np.random.default_rng(seed)
    for now, given in enumerate(course(seed, n, 2000)):
        measured, commanded, sent, flag, told = given
        again = copied(given)
        if now % 50 == 0:
            # In ticks, of one nanosecond here.
            plain.doubt_ns[:] = now + doubt.integers(0, 30, n)
            kept.rotors["doubt_until_ns"] = plain.doubt_ns
        reference.assess_train(measured, commanded, sent, flag, now, TICK_S, told, plain)
        assess_train(*again[:4], now, TICK_S, again[4], kept)
        same(kept.rotors, plain)
        np.testing.assert_array_equal(again[1], commanded)
        for mine, wanted in zip(again[4], told, strict=True):
            np.testing.assert_array_equal(mine, wanted)
        for name, states in met.items():
            states |= set(kept.rotors[name].tolist())
    if n > 3:
        assert sum(states == {0, 1} for states in met.values()) > 4, met


def test_ratings_are_those_of_the_motors():
    kept = train.start([BENCH_MOTOR, OTHER, BENCH_MOTOR])
    assert kept.rotors["motor"].tolist() == [0, 1, 0]
    rated = BENCH_MOTOR.T_rated
    assert kept.rotors["rated_nm"].tolist() == [rated, 2.0 * rated, rated]
    assert (kept.rotors["doubt_until_ns"] == NEVER).all()
    # What is written by the plausibility check and read here is one and the same.
    kept.doubt_ns[1], kept.rotors["uncertain"][2] = 7, 1
    assert kept.rotors["doubt_until_ns"].tolist() == [NEVER, 7, NEVER]
    assert kept.uncertain.tolist() == [0, 0, 1]
