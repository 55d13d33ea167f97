"""Loads beside commands, and that the compiled loop is the same function uncompiled."""

import math

import numpy as np
import pytest

from gateway import loads, slow, tracks
from gateway._loads_kernels import prepare
from gateway.config import BENCH_MOTOR
from gateway.health import Flag, Health

N = 3
MS = 1_000_000
TICK_S = 0.01


def drives(load=(15.0, 15.0, 15.0), speed=(25.0, 25.0, 25.0), command=(20.0, 20.0, 20.0)):
    told, sent = tracks.told(N), slow.start(N)
    told.health[:] = Health.TRACKING
    told.load[:], told.speed[:] = load, speed
    sent.command[:] = sent.before[:] = command
    return told, sent


def prepared(told, sent, *, follows=(False,) * N, fresh=(True,) * N, rotors=None, kernel=prepare):
    at, heard = loads.instant(N), loads.responses(N)
    rotors = rotors or loads.rotors([BENCH_MOTOR] * N)
    flag = np.where(follows, Flag.BAD, Flag.GOOD)
    since = np.full(N, -loads.FOLLOWING_NS)
    kernel(told, sent, np.array(fresh), flag, since, 10 * MS, TICK_S, rotors, at, heard)
    return at, heard


def test_a_drive_that_is_told_less_has_a_smaller_share():
    at, heard = prepared(*drives(command=(20.0, 10.0, -20.0)))
    assert at.share.tolist() == [1.0, 0.5, 1.0]
    assert at.known.all()
    assert heard["command"].tolist() == pytest.approx([2 / 3, 1 / 3, -2 / 3])


def test_commands_that_change_are_compared_for_those_that_follow_their_flag_only():
    told, sent = drives(command=(20.0, 6.0, 15.0))
    sent.steady[2] = False
    assert prepared(told, sent)[0].share.tolist() == [1.0] * N
    at, _ = prepared(told, sent, follows=(False, True, False))
    assert at.share.tolist() == pytest.approx([1.0, 0.3, 1.0])
    sent.steady[2] = True
    assert prepared(told, sent)[0].share.tolist() == pytest.approx([1.0, 0.3, 0.75])


def test_what_is_not_known_is_not_judged():
    told, sent = drives(command=(20.0, 1.0, 20.0))
    told.health[2] = Health.PREDICTING
    at, heard = prepared(told, sent, fresh=(False, True, True))
    assert at.known.tolist() == [True, False, False], "and a twentieth carries too little"
    assert not heard["usable"].any()
    assert at.share[1] == loads.SHARE_FLOOR


def test_a_drive_mounted_the_other_way_round():
    at, heard = prepared(*drives(load=(15.0, -15.0, 15.0), speed=(25.0, -25.0, 25.0)))
    assert at.load.tolist() == [0.5] * N
    assert heard["load"].tolist() == [0.5, -0.5, 0.5]


def test_a_rotor_that_runs_away_shows_where_it_is_alone_and_for_two_ticks():
    rotors = loads.rotors([BENCH_MOTOR] * N)
    seen = []
    for speed in (25.0, 26.0, 26.0, 26.0):
        told, sent = drives(speed=(speed,) * N)
        told.health[1:] = Health.CONVERGING
        seen.append(prepared(told, sent, rotors=rotors)[1]["acceleration_torque"][0])
    gained = BENCH_MOTOR.J * 1.0 / TICK_S / BENCH_MOTOR.T_rated
    assert seen == pytest.approx([0.0, gained, gained, 0.0])
    # With others to compare with it is not asked for, and the speed of long ago says nothing.
    assert not prepared(*drives(speed=(40.0,) * N), rotors=rotors)[1]["acceleration_torque"].any()
    told, sent = drives(speed=(99.0,) * N)
    told.health[1:] = Health.CONVERGING
    assert not prepared(told, sent, rotors=rotors)[1]["acceleration_torque"].any()


def test_compiled_equals_uncompiled():
    rng = np.random.default_rng(3)
    both = [loads.rotors([BENCH_MOTOR] * N) for _ in range(2)]
    for _ in range(300):
        told, sent = drives(
            rng.normal(0.0, 20.0, N), rng.normal(5.0, 20.0, N), rng.normal(5.0, 9.0, N)
        )
        told.health[:] = rng.choice([1, 2, 2, 2], N)
        for column in (told.load, told.speed):
            column[rng.random(N) < 0.1] = math.nan
        fresh = rng.random(N) < 0.8
        sent.command[~fresh & (rng.random(N) < 0.5)] = math.nan
        sent.steady[:] = rng.random(N) < 0.8
        follows = rng.random(N) < 0.3
        given = [
            prepared(told, sent, fresh=fresh, follows=follows, rotors=rotors, kernel=kernel)
            for rotors, kernel in zip(both, (prepare, prepare.py_func), strict=True)
        ]
        for fast, plain in zip(*((*at, heard) for at, heard in given), strict=True):
            np.testing.assert_array_equal(fast, plain)
