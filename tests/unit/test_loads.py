"""Loads beside commands: what the detector and the responses are given (`gateway/core/loads.c`)."""

import numpy as np
import pytest

from dbc.records import DRIVE_STATUS
from gateway.core import flags, inputs, receiving
from gateway.core.adhesion import AdhesionMonitor
from gateway.core.codes import Flag, Health
from gateway.core.flags import FlagKind, Timing
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Adhesion
from tests import columns
from tests.judged_loads import detect
from tests.reference.adhesion import DERATING_NS, RATIO_FLOOR

N = 3
MS = 1_000_000
TICK_S = 0.01
TIMING = Timing(0, 0, 0)


class Drives:
    """What is estimated and commanded of N drives."""

    def __init__(
        self, load=(15.0, 15.0, 15.0), speed=(25.0, 25.0, 25.0), command=(20.0, 20.0, 20.0)
    ):
        self.told, self.records = columns.told(N), receiving.drive_inputs(N)
        self.sent = columns.slow_of(self.records)
        self.told.health[:] = Health.TRACKING
        self.told.load[:], self.told.speed[:] = load, speed
        self.sent.command[:] = self.sent.before[:] = command
        self.sent.operating[:] = True


def monitor():
    rules = flags.rules([TIMING] * 5, TIMING, 0.7, 0.2, 10 * MS)
    return AdhesionMonitor(Adhesion(), [BENCH_MOTOR] * N, rules, 10 * MS)


def prepared(drives, *, follows=(False,) * N, fresh=(True,) * N, core=None):
    """Command ratios, what is known, and loads beside commands, after one tick."""
    core = core or monitor()
    status = np.zeros(N, DRIVE_STATUS)
    flag = status["flag"][:, FlagKind.ADHESION]
    flag["state"] = np.where(follows, Flag.BAD, Flag.GOOD)
    flag["since_ns"] = -DERATING_NS
    come = inputs.statuses(N)
    come["command_valid"], come["speed_rad_s"] = fresh, drives.told.speed
    detect(core, drives.told.estimates, come, drives.records, status, 10 * MS)
    return core


def ratios(core):
    return core.loads["command_ratio"].tolist()


def test_a_drive_that_is_asked_for_less_has_a_smaller_ratio():
    core = prepared(Drives((15.0, 7.5, -15.0), (25.0, 25.0, -25.0), (20.0, 10.0, -20.0)))
    assert ratios(core) == [1.0, 0.5, 1.0]
    assert core.known.all()
    assert core.responses["command"].tolist() == pytest.approx([2 / 3, 1 / 3, -2 / 3])


def test_commands_that_change_are_compared_for_those_that_follow_their_flag_only():
    drives = Drives(command=(20.0, 20.0, 6.0), load=(20.0, 20.0, 6.0))
    drives.sent.steady[1] = False
    assert ratios(prepared(drives)) == [1.0] * N
    core = prepared(drives, follows=(False, False, True))
    assert ratios(core) == pytest.approx([1.0, 1.0, 0.3])
    drives.sent.steady[1] = True
    assert ratios(prepared(drives)) == pytest.approx([1.0, 1.0, 0.3])


def test_what_is_not_known_is_not_judged():
    core = prepared(Drives(command=(20.0, 1.0, 20.0), load=(15.0, 0.75, 15.0)))
    assert core.known.tolist() == [True, False, True], "a twentieth carries too little"
    assert ratios(core)[1] == RATIO_FLOOR
    drives = Drives()
    drives.told.health[2] = Health.PREDICTING
    core = prepared(drives, fresh=(False, True, True))
    assert core.known.tolist() == [True, True, False]
    assert core.responses["usable"].tolist() == [False, True, False]


def test_a_drive_mounted_the_other_way_round():
    core = prepared(Drives(load=(15.0, -15.0, 15.0), speed=(25.0, -25.0, 25.0)))
    assert core.loads["load"].tolist() == [0.5] * N
    assert core.responses["load"].tolist() == [0.5, -0.5, 0.5]


def test_a_rotor_that_runs_away_shows_where_it_is_alone_and_for_two_ticks():
    core, seen = monitor(), []
    for speed in (25.0, 26.0, 26.0, 26.0):
        drives = Drives(speed=(speed,) * N)
        drives.told.health[1:] = Health.CONVERGING
        seen.append(prepared(drives, core=core).responses["acceleration_torque"].item(0))
    gained = BENCH_MOTOR.J * 1.0 / TICK_S / BENCH_MOTOR.T_rated
    assert seen == pytest.approx([0.0, gained, gained, 0.0])
    # With others to compare with it is not wanted, and the speed of long ago says nothing.
    prepared(Drives(speed=(40.0,) * N), core=core)
    assert not core.responses["acceleration_torque"].any()
    drives = Drives(speed=(99.0,) * N)
    drives.told.health[1:] = Health.CONVERGING
    assert not prepared(drives, core=core).responses["acceleration_torque"].any()


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("effort", [0.5, -0.5])
@pytest.mark.parametrize(("per_tick", "doubtful"), [(1.0, 1), (-1.0, 1), (0.02, 0), (-0.02, 0)])
def test_a_drive_without_others_is_uncertain_while_no_train_changes_its_speed_so(
    way, effort, per_tick, doubtful
):
    """A wheel that slid slows against its effort: until that ends, it has not gripped again."""
    core, load = monitor(), way * effort
    for k in range(40):
        speed = (way * (90.0 + per_tick * k), np.nan, np.nan)
        drives = Drives((load * BENCH_MOTOR.T_rated,) * N, speed, (40.0 * load,) * N)
        drives.told.health[1:] = Health.CONVERGING
        prepared(drives, core=core)
    assert core.rotors["uncertain"][0] == doubtful


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(("effort", "least", "most"), [(0.5, -0.02, 0.06), (-0.5, -0.06, 0.02)])
def test_against_the_effort_only_a_hill_accelerates_a_train(way, effort, least, most):
    """A wheel that grips again slows at once; the mean of its speed still holds the slide."""
    core, credit = monitor(), {30.0: [], 90.0: [], 99.0: []}
    load = way * effort
    for speed in [90.0] * 60 + [30.0] * 60 + [99.0] * 60:
        drives = Drives((load * BENCH_MOTOR.T_rated,) * N, (way * speed,) * N, (40.0 * load,) * N)
        seen = prepared(drives, core=core).responses["load"].item(0)
        credit[speed].append(way * (seen - load))
    assert min(credit[30.0]) == pytest.approx(least)
    assert max(credit[99.0]) == pytest.approx(most)
