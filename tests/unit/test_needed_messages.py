"""What docs/inverters.md says of the messages that each flag needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gateway
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.simulation import Simulation
from tests.sender import CLASSIC, FD_FILE
from tests.simrun import TICK, codec, scenario

NODES = (1, 2, 3)
CALIBRATION = Path(gateway.__path__[0]) / "bench_calibration.toml"
FLAGS = ("adhesion", "thermal", "sensor", "comm", "estimator")
SLOW, FAST = 200.0, 600.0
"""Electrical rad/s: above and below ten samples of 2 ms in a revolution."""
DAY = 550
"""Ticks, of which the last 50 are looked at: thermal flags need 5 s."""


def known(without, w_e, path=CLASSIC):
    """Flags of drive 1 that are known, with those messages of the drives not sent."""
    used = codec(NODES, path)
    run = scenario(seed=3, duration_s=6.0, motion={"profile": [[0.0, w_e]]})
    simulation = Simulation(run, used, nodes=NODES)
    tables = {"thermal": {"calibration": str(CALIBRATION)}, "drive": [{"node": n} for n in NODES]}
    core = Gateway(parse(tables), used, 0)
    gone = {m.can_id for m in used.messages if m.name.partition("_")[2] in without}
    assert len(gone) >= len(NODES) * len(without)
    seen = []
    for now in range(TICK, DAY * TICK + 1, TICK):
        core.step([f for f in simulation.step((), now) if f.can_id not in gone], now)
        seen.append([getattr(core.view.drives[0], flag) for flag in FLAGS])
    last = np.array(seen[-50:])
    assert not (last == Flag.BAD).any()
    always = (last == Flag.GOOD).all(axis=0)
    assert (always | (last == Flag.UNKNOWN).all(axis=0)).all()
    return {flag for flag, is_known in zip(FLAGS, always, strict=True) if is_known}


@pytest.mark.parametrize(
    ("without", "w_e", "unknown"),
    [
        ((), SLOW, ""),
        ((), FAST, ""),
        (("PhaseCurrents",), SLOW, "adhesion estimator comm"),
        (("StatorVoltages",), FAST, "adhesion estimator comm"),
        (("Motion",), SLOW, "thermal"),
        (("Motion",), FAST, "thermal adhesion estimator"),
        (("Status",), FAST, "thermal"),
        (("Temperatures",), FAST, "thermal sensor"),
        (("Status", "Temperatures"), FAST, "thermal sensor"),
        (("Motion", "Status", "Temperatures"), SLOW, "thermal sensor"),
    ],
)
def test_what_is_unknown_without_a_message(without, w_e, unknown):
    assert known(without, w_e) == set(FLAGS) - set(unknown.split())


def test_on_can_fd_currents_alone_are_enough_at_any_speed():
    without = ("Motion", "Status", "Temperatures")
    assert known(without, FAST, FD_FILE) == {"adhesion", "comm", "estimator"}
    assert known(("Samples",), FAST, FD_FILE) == {"thermal", "sensor"}
