"""Faults of a motor; the 350 kW one mostly turns beyond ten samples per revolution."""

from __future__ import annotations

import pytest

from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.study.evaluation_runs import Plan, fitted, one_run, record
from gateway.study.scenarios_family import draw

MOTOR = "traction_350kw"
OPEN_S = 1.0


def measured(family, seed):
    plan = Plan((family,), ("vb",), (seed,), motor=MOTOR)
    return one_run(plan, family, seed)[0].flags


@pytest.mark.parametrize(
    ("motor", "seed", "within_s"),
    [(MOTOR, 0, 0.05), (MOTOR, 2, 0.05), (MOTOR, 6, 0.05), (MOTOR, 1, 1.2), ("bench", 0, 1.2)],
)
def test_an_open_phase_is_said(motor, seed, within_s):
    """Where the filters do not reach (0, 2, 6), and where they lose their lock.

    The torque pulsates, so does the load of the observer: it knows nothing of the wheel.
    """
    scenario = draw("off_phase_open", seed, motor)
    config, codec = fitted(Plan((), ("vb",), (), motor=motor), "vb", scenario)
    gateway, views = Gateway(config, codec, 0), []
    for tick, block in enumerate(record(scenario, config, codec).blocks):
        now = tick * config.loop.period_ns
        gateway.step(block, now)
        views.append((now * 1e-9, gateway.view))
    first = [v.drives[0] for t, v in views if OPEN_S - 0.5 < t < OPEN_S]
    rest = [v.drives[0] for t, v in views if t > OPEN_S + within_s]
    assert {d.adhesion for d in first} == {Flag.GOOD}
    assert {(d.adhesion, d.health, d.adhesion_reason) for d in rest} == {
        (Flag.UNKNOWN, Health.INPUT_INVALID, Reason.RANGE)
    }
    soon = {v.drives[0].adhesion for t, v in views if t > OPEN_S + 0.05}
    others = {d.adhesion for t, v in views if 0.3 < t < 2.0 for d in v.drives[1:]}
    assert soon == {Flag.UNKNOWN}
    assert others == {Flag.GOOD}


@pytest.mark.parametrize("seed", [1, 10, 14])
def test_a_flux_off_by_a_fifth_raises_nothing_and_hides_nothing(seed):
    """Seed 14 turns too fast for the filters: the torque is the drive's own, of the data sheet."""
    flags = measured("off_psi_up", seed)
    assert flags.alarms == 0
    assert flags.missed == 0
    assert flags.f1 > 0.75
