"""Wheels that carry less than they are asked for beside one that carries it, and below brakes."""

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
from tests.learnt import Responses
from tests.reference.command_response import Heard

MS = 1_000_000
TICK_S, SPREAD = 0.01, 0.7 / 30.0
CLEARED, RAISED = 0.5, 0.9
AT_ONCE = Timing(0, 0, 0)


def probabilities(share, noise, seed, ticks=300):
    """(ticks, N) of drives that carry a share of commands that rise; `Status` comes each 100 ms."""
    n, rng = len(share), np.random.default_rng(seed)
    rules = flags.rules([AT_ONCE] * 5, AT_ONCE, RAISED, CLEARED, 10 * MS)
    core = AdhesionMonitor(Adhesion(), [BENCH_MOTOR] * n, rules, 10 * MS)
    status, told, drives = np.zeros(n, DRIVE_STATUS), columns.told(n), receiving.drive_inputs(n)
    come, sent, found = inputs.statuses(n), columns.slow_of(drives), []
    told.health[:], told.sigma[:], told.nis[:], sent.operating[:] = Health.TRACKING, 0.1, 1.0, True
    come["command_valid"] = True
    asked = BENCH_MOTOR.T_rated * np.minimum(0.6, 0.3 * TICK_S * np.arange(ticks))
    for tick in range(ticks):
        at = tick // 10 * 10
        told.load[:] = asked[tick] * share + BENCH_MOTOR.T_rated * rng.normal(0.0, noise, n)
        told.speed[:] = come["speed_rad_s"] = 60.0
        sent.command[:], sent.before[:] = asked[at], asked[max(at - 10, 0)]
        sent.command_ns[:], sent.steady[:] = at * 10 * MS, asked[at] == asked[at - 10]
        detect(core, told.estimates, come, drives, status, tick * 10 * MS)
        found.append(p := np.array(core.loss_probability))
        flag = status["flag"][:, FlagKind.ADHESION]
        flag["state"] = np.where(p >= RAISED, Flag.BAD, np.where(p <= CLEARED, Flag.GOOD, 0))
    return np.array(found)


@pytest.mark.parametrize("seed", [0, 1])
def test_half_of_all_wheels_on_a_rail_that_was_bad_before_they_pulled(seed):
    """The comparison alone takes what they carry for their usual share."""
    p = probabilities(np.array([0.7] * 3 + [1.0] * 3), 0.05, seed)
    assert (p[120:, :3] <= CLEARED).mean() < 0.4
    assert not (p[:, 3:] >= RAISED).any()


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_drive_that_carries_a_tenth_less_or_more_is_not_lost(share):
    p = probabilities(np.array([share, 1.0, 1.0]), 0.03, 0)
    assert not (p >= RAISED).any()


def deficits(lost_s, shown_s, ticks=100):
    """P(deficit) of a drive that brakes with 0.5: 0.17 are gone after lost_s. From shown_s on its
    rotor slows as if friction brakes had taken them over."""
    drive, one, found = Responses(1, SPREAD), np.ones(1), []
    for tick in range(ticks):
        load = -0.5 + 0.17 * min(1.0, tick * TICK_S / lost_s)
        braked = -0.5 if tick * TICK_S >= shown_s else load
        age = one * (tick % 10) * TICK_S
        asked = -0.5 * one
        heard = Heard(load * one, braked * one, 0.0 * one, asked, asked, age, one > 0.0)
        found.append(drive.respond(heard, TICK_S)[0].item())
    return np.array(found)


def test_brakes_explain_a_load_that_goes_as_they_come_but_not_one_that_was_missing_before():
    assert (deficits(lost_s=0.5, shown_s=0.0) < RAISED).all()
    assert (deficits(lost_s=0.01, shown_s=0.05)[25:] >= RAISED).all()
