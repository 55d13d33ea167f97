"""Drives that are asked for nothing: rolling wheels adhere, and who is asked nobody sees alone."""

from __future__ import annotations

import pytest

from dbc.frames import block_of
from gateway.core.codes import Flag, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from gateway.study.held_world import STATUS
from sim.simulation import Simulation
from tests.simrun import TICK, codec, scenario

COASTS_S = 2.2
END_S = 4.0


def said(*, commands: bool, slows: bool = False):
    """Flags and reasons of all drives from half a second after the train has begun to coast."""
    speeds = [[0.0, 120.0], [COASTS_S, 120.0], [END_S, 40.0 if slows else 120.0]]
    train = scenario(
        duration_s=END_S, drives=3, seed=5, motion={"profile": speeds},
        load={"kind": "preset", "transition": "linear",
              "profile": [[0.0, 15.0], [2.0, 15.0], [COASTS_S, 0.0]]},
    )  # fmt: skip
    simulation, gateway, out = Simulation(train, codec()), Gateway(parse({}), codec(), 0), []
    for tick in range(1, round(END_S * 100)):
        block = block_of(simulation.step((), tick * TICK))
        if not commands:
            block = block.pick([can_id not in STATUS for can_id in block.can_id])
        gateway.step(block, tick * TICK)
        if tick >= 100 * (COASTS_S + 0.5):
            out += [(drive.adhesion, drive.adhesion_reason) for drive in gateway.view.drives]
    return set(out)


def test_wheels_that_roll_with_the_others_adhere():
    assert said(commands=True) == {(Flag.GOOD, Reason.NONE)}


@pytest.mark.parametrize("how", [{"commands": False}, {"commands": True, "slows": True}])
def test_nobody_knows_where_more_may_have_been_asked_or_a_brake_slows_them(how):
    """Without commands a train that coasts and one whose wheels are all lost look alike."""
    assert {flag for flag, _ in said(**how)} == {Flag.UNKNOWN}
