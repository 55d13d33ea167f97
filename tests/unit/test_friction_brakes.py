"""A train that friction brakes slow: its rotors take a part of the torque, no wheel is lost."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.simulation import Simulation
from tests.simrun import TICK, codec, scenario

NODES = (1, 2, 3)
MOTOR = "traction_350kw"
LOAD_NM = -283.0
"""Of 796 Nm rated. A rotor that slows by 10 rad/s^2 takes 110 Nm more."""
ONE = {"at_s": 2.0, "for_s": 0.5, "drive": 1, "kind": "adhesion_loss", "depth": 0.8}
ALL = {"at_s": 1.0, "drive": "all", "kind": "adhesion_loss", "depth": 0.3, "ramp_s": 0.5}
BRAKES = [[0.5, 540.0], [8.5, 380.0]]
"""Electrical rad/s: 10 rad/s^2 at the rotor, an emergency brake of 1.4 m/s^2, from 38 m/s."""


def flags_and_speeds(seconds, **changes):
    """Flags and true rotor speeds, both (ticks, N)."""
    run = scenario(seed=3, duration_s=seconds, motor={"name": MOTOR}, **changes)
    simulation = Simulation(run, codec(NODES), nodes=NODES)
    drives = [{"node": node, "motor": MOTOR} for node in NODES]
    core = Gateway(parse({"drive": drives}), codec(NODES), 0)
    flags = []
    for k in range(1, round(seconds * 100) + 1):
        core.step(simulation.step((), k * TICK), k * TICK)
        flags.append([drive.adhesion for drive in core.view.drives])
    speeds = np.reshape([row.speed_rad_s for row in simulation.truth_rows()], (-1, len(NODES)))
    return np.array(flags), np.abs(speeds[: len(flags)])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_emergency_brake_is_no_loss_of_all(sign):
    profile = [[at, sign * speed] for at, speed in BRAKES]
    load = {"kind": "preset", "torque_nm": sign * LOAD_NM}
    flags, _ = flags_and_speeds(3.0, motion={"profile": profile}, load=load, event=[ONE])
    assert (flags[60:195] == Flag.GOOD).all()
    assert (flags[60:, 1:] == Flag.GOOD).all()
    assert (flags[205:245, 0] == Flag.BAD).all()
    assert (flags[260:, 0] == Flag.GOOD).all()


def test_nobody_knows_for_longer_whether_brakes_or_a_loss_of_all_slow_the_rotors():
    load = {"kind": "preset", "torque_nm": LOAD_NM}
    flags, _ = flags_and_speeds(8.0, motion={"profile": BRAKES}, load=load)
    assert not (flags == Flag.BAD).any()
    assert (flags[60:200] == Flag.GOOD).all()
    assert (flags[550:] == Flag.UNKNOWN).all()


def test_all_wheels_that_slide_gently_are_not_adhering_beyond_a_tenth():
    """Less is missing than an emergency brake would take; nothing limits the slip."""
    load = {"kind": "rail", "torque_nm": LOAD_NM}
    motion = {"profile": [[0.0, 540.0]], "effort_nm": 800.0}
    flags, speeds = flags_and_speeds(
        8.0, motion=motion, load=load, slip_limiter="none", event=[ALL]
    )
    assert (flags[60:100] == Flag.GOOD).all()
    slid = speeds < 0.9 * speeds[100]
    assert slid[-1].all()
    for drive in range(len(NODES)):
        first = int(np.argmax(slid[:, drive]))
        assert not (flags[first + 20 :, drive] == Flag.GOOD).any()
