"""Bogies on rollers: mechanics that hold, and losses that are found in them."""

import numpy as np
import pytest

from gateway.study import roller_world
from gateway.study.evaluation_runs import Plan, evaluate
from sim.physics.plant import LOAD, SPEED, TORQUE


def test_healthy_wheels_carry_what_their_motors_give_and_creep_below_the_peak():
    scenario = roller_world.draw("roller_healthy", 1)
    rows = roller_world.waveforms("roller_healthy", scenario).rows
    rated = 30.0
    assert np.abs(rows[..., LOAD] - rows[..., TORQUE]).max() < 0.02 * rated
    spread = np.ptp(rows[..., SPEED], axis=1) / np.abs(rows[..., SPEED]).min(axis=1)
    assert spread.max() < roller_world.PEAK_CREEP[1]


@pytest.mark.parametrize("name", ["roller", "roller_slow", "roller_none"])
@pytest.mark.parametrize("seed", range(2))
def test_under_a_loss_the_wheel_runs_away_as_its_effort_goes_and_never_turns_back(name, seed):
    scenario = roller_world.draw(name, seed)
    rows = roller_world.waveforms(name, scenario).rows
    (event,) = scenario.event
    lost = event.drive - 1
    speed, others = rows[:, lost, SPEED], np.delete(rows[..., SPEED], lost, axis=1).mean(axis=1)
    effort = np.sign(scenario.load.profile[0][1] * others[0])
    ahead = effort * (np.abs(speed) - np.abs(others)) / np.abs(others)
    assert ahead.max() > roller_world.PEAK_CREEP[0]
    assert (speed / others).min() > -0.1  # it may swing back by as much as its torque's lag


def test_loss_on_a_roller_is_found_and_nothing_healthy_is_flagged():
    plan = Plan(("roller", "roller_healthy"), ("switching",), (0, 1), world="roller")
    loss, healthy = evaluate(plan)
    assert loss.total.flags.losses == 2
    assert loss.total.flags.missed == 0
    assert healthy.total.flags.alarms == 0
