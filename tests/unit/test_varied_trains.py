"""Trains of any motor on any bus: what is drawn is possible, and is found."""

import math

import pytest

from dbc.codec import bind
from dbc.frame import MS
from dbc.frames import block_of
from gateway.settings.config import parse
from gateway.settings.motors import Motor
from gateway.study.roller_world import draw
from gateway.study.varied_trains import variation
from gateway.study.worlds import WORLDS

SEEDS = range(60)


def test_every_motor_is_one_that_a_configuration_takes():
    for seed in SEEDS:
        sheet = variation(seed).sheet()
        link = sheet.pop("U_dc")
        motor = Motor(**sheet)
        rated = motor.voltage(1000.0, motor.I_rated)
        assert math.isfinite(rated)
        assert link > math.sqrt(3.0) * abs(variation(seed).speed_rad_s) * motor.psi_pm


def test_all_kinds_are_drawn_and_none_that_nobody_could_tell_anything_from():
    drawn = [variation(seed) for seed in SEEDS]
    assert {v.cycle_ms for v in drawn} == {1, 2, 4, 5, 10}
    assert {(v.motion, v.status) for v in drawn} == {(a, b) for a in (0, 1) for b in (0, 1)}
    kilowatts = [v.motor.T_rated * 300.0 / v.motor.pole_pairs / 1e3 for v in drawn]
    assert min(kilowatts) < 1.0
    assert max(kilowatts) > 100.0
    for v in drawn:
        assert v.status or v.drives > 1
        assert v.motion or abs(v.speed_rad_s) * v.cycle_ms * 1e-3 <= 2.0 * math.pi / 10


@pytest.mark.parametrize("seed", [3, 8])
def test_what_is_absent_never_comes_and_cycles_are_as_drawn(seed):
    v = variation(seed)
    codec = v.codec(bind(parse({}).dbc_path, range(1, v.drives + 1)))
    run = draw("roller_varied", seed).model_copy(update={"duration_s": 0.4, "event": []})
    sent = block_of(WORLDS["ours"].simulate("", run, codec).step((), 400 * MS))
    seen = v.received(sent, codec).can_id.tolist()
    there = {kind: codec.by_name[f"Drive1_{kind}"].can_id in seen for kind in ("Motion", "Status")}
    assert there == {"Motion": v.motion, "Status": v.status}
    currents = codec.by_name["Drive1_PhaseCurrents"].can_id
    assert seen.count(currents) == pytest.approx(400 / v.cycle_ms, abs=2)
