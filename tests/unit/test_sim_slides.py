"""Wheels that run away, slide and lock: slip limiters and friction brakes, by physics alone."""

import math

import numpy as np
import pytest

from dbc.codec import bind
from gateway.study.scenarios_family import draw
from sim.physics import plant as c
from sim.physics.adhesion import RAILS, available
from sim.physics.plant import BENCH, DT, MOTORS, TRAIN, Plant, rail_array
from sim.scenario import builtin, parse
from sim.simulation import Simulation
from tests.simrun import CLASSIC, codec, run, scenario, values
from tests.thorough import some

TOP_RAD_S = BENCH.U_dc / math.sqrt(3) / (BENCH.pole_pairs * BENCH.psi_pm)
"""Without load and without field weakening: 218 rad/s, where the back-EMF takes all the voltage."""


class Rows:
    """A scenario run without a gateway: (n, drives) of the truth, every 10 ms."""

    def __init__(self, seconds, table=None, simulation=None):
        self.simulation = simulation or Simulation(scenario(**table), codec())
        drives = len(self.simulation.nodes)
        self.frames = run(self.simulation, seconds)
        rows = self.simulation.truth_rows()
        self.speed, self.load, self.lost, self.depth = (
            np.array([getattr(r, name) for r in rows], float).reshape(-1, drives)
            for name in ("speed_rad_s", "load_nm", "lost", "depth")
        )
        self.t_s = np.array([r.t_s for r in rows]).reshape(-1, drives)[:, 0]
        assert np.isfinite([self.speed, self.load]).all()

    def between(self, start, end):
        return (self.t_s > start + 1e-9) & (self.t_s < end + 1e-9)

    def creep(self, drive):
        """Of a drive counted from 1, against the median wheel."""
        train = np.median(self.speed, axis=1)
        return (self.speed[:, drive - 1] - train) / np.abs(train)


def loss(depth, at_s=0.5, **more):
    return {"at_s": at_s, "drive": 1, "kind": "adhesion_loss", "depth": depth, **more}


def brake(nm, at_s=0.5, drive="all", **more):
    return {"at_s": at_s, "drive": drive, "kind": "friction_brake", "value": nm, **more}


def advance(plant, seconds, *, w_ref=25.0, load=0.0, carry=1.0, rail="dry"):
    drives = len(plant.drives)
    n = round(seconds / DT)
    rails = np.tile(rail_array([RAILS[rail]] * drives), (n, 1, 1))
    shares = np.full((n, drives), carry)
    cut = np.zeros((n, drives), bool)
    return plant.advance(np.full(n, w_ref), np.zeros(n), np.full(n, load), shares, cut, rails)


def build(drives=2, w_0=25.0, load=18.0, motor=BENCH):
    return Plant(motor, np.arange(float(drives)), on_rail=True, w_0=w_0, load_0=load)


# --- slip limiters ---------------------------------------------------------------------------


def test_a_fast_limiter_is_the_default_and_holds_five_percent():
    assert parse({"title": "t", "duration_s": 1.0}).slip_limiter == "fast"
    table = {"event": [loss(1.0)]}
    plain = Rows(1.5, table)
    named = Rows(1.5, {**table, "slip_limiter": "fast"})
    assert named.frames == plain.frames
    assert np.abs(plain.creep(1)[70:]).max() < 0.08


def test_without_a_limiter_a_small_loss_that_grows_makes_the_wheel_run_away():
    table = {"slip_limiter": "none", "motion": {"speed": 280.0},
             "event": [loss(0.25, ramp_s=6.0)]}  # fmt: skip
    rows = Rows(5.0, table)
    held = Rows(5.0, {**table, "slip_limiter": "fast"})
    assert np.abs(held.creep(1)).max() < 0.06
    creep = rows.creep(1)
    assert np.all(np.diff(rows.speed[rows.between(1.0, 4.0), 0]) > 0.0), "ever faster"
    assert creep[-1] > 1.0
    # What it delivers is still most of what is asked: load alone hardly shows it.
    assert rows.load[-1, 0] > 0.8 * rows.load[-1, 1]
    # The motor goes on making what is commanded, and the others do not slip.
    torque = values(rows.frames, "Drive1_Motion")[250]["Torque"]
    assert torque == pytest.approx(18.0, abs=0.6)
    assert np.abs(rows.creep(2)).max() < 0.01


@pytest.mark.parametrize(("torque", "speed"), [(18.0, 100.0), (-18.0, 100.0), (18.0, -100.0)])
def test_a_wheel_without_limiter_is_bounded_by_voltage_and_its_frames_are_valid(torque, speed):
    table = {"slip_limiter": "none", "motion": {"speed": speed}, "load": {"torque_nm": torque},
             "event": [loss(1.0, for_s=1.5)]}  # fmt: skip
    rows = Rows(3.5, table)
    fastest = np.abs(rows.speed[:, 0]).max()
    assert 0.95 * TOP_RAD_S < fastest < 1.02 * TOP_RAD_S
    assert np.sign(rows.speed[rows.between(1.5, 2.0), 0]).tolist() == [np.sign(torque)] * 50
    for name in ("Motion", "PhaseCurrents", "StatorVoltages", "Status"):
        got = values(rows.frames, f"Drive1_{name}")
        assert all(v is not None and math.isfinite(v) for row in got for v in row.values())


def test_a_slow_limiter_lets_the_wheel_run_for_half_a_second_and_then_holds_15_percent():
    table = {"slip_limiter": "slow", "motion": {"speed": 200.0}, "event": [loss(0.5, for_s=2.0)]}
    rows = Rows(4.5, table)
    creep = rows.creep(1)
    assert creep[rows.between(0.5, 0.8)].max() > 0.3
    assert creep[rows.between(1.1, 2.5)].max() < 0.16
    assert creep[rows.between(1.5, 2.5)].min() > 0.12
    # It grips again, and the torque comes back within a second.
    assert np.abs(creep[rows.between(2.7, 4.5)]).max() < 0.02
    late = rows.between(3.6, 4.5)
    np.testing.assert_allclose(rows.load[late, 0], rows.load[late, 1], atol=0.5)


@pytest.mark.parametrize(("limiter", "lost"), [("fast", 1), ("slow", 0), ("none", 0)])
def test_what_a_rail_gives_depends_on_the_creep_that_the_drive_allows(limiter, lost):
    # At 5 m/s wet rail carries 20.5 Nm within 5 % creep, 23.4 within 15 %, 23.5 at its peak.
    table = {"slip_limiter": limiter, "load": {"torque_nm": 22.0, "rail": "wet"},
             "motion": {"effort_nm": 22.5}}  # fmt: skip
    rows = Rows(2.0, table)
    assert rows.lost[100:].mean() == lost
    carried = rows.load[100:].mean()
    assert carried == pytest.approx(20.4 if lost else 22.0, abs=0.3)


# --- friction brake --------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_brakes_on_dry_rail_slow_the_train_while_the_motors_coast(sign):
    table = {"load": {"torque_nm": 12.0 * sign}, "motion": {"speed": 200.0 * sign},
             "event": [brake(18.0)]}  # fmt: skip
    rows = Rows(2.0, table)
    assert not rows.lost.any()
    late = rows.between(0.7, 2.0)
    # All that turns and rolls is slowed by brake and gradient together.
    slope = -(18.0 + 12.0) / (TRAIN.inertia(BENCH) + BENCH.J)
    measured = np.gradient(sign * rows.speed[late, 0], 0.01)
    np.testing.assert_allclose(measured, slope, rtol=0.03)
    np.testing.assert_allclose(sign * rows.load[late], -17.5, atol=0.3)
    status = [s for s in values(rows.frames, "Drive1_Status") if s["t_s"] > 0.85]
    assert max(abs(s["TorqueCommand"]) for s in status) < 0.1
    assert max(s["Irms"] for s in status) < 0.3


def test_the_demand_falls_within_150_ms_and_not_at_once():
    rows = Rows(1.0, {"load": {"torque_nm": 12.0}, "event": [brake(18.0, ramp_s=0.3)]})
    torque = np.array([m["Torque"] for m in values(rows.frames, "Drive1_Motion")])
    assert torque[51] > 5.0
    assert np.abs(torque[66:]).max() < 0.5


def test_brakes_stop_the_train_hold_it_on_a_gradient_and_never_turn_a_wheel():
    event = brake(20.0, for_s=3.0, ramp_s=0.2)
    rows = Rows(5.0, {"load": {"torque_nm": 8.0}, "motion": {"effort_nm": 24.0}, "event": [event]})
    assert rows.speed[rows.between(0.0, 3.2)].min() >= 0.0
    held = rows.between(2.6, 3.2)
    assert not rows.speed[held].any()
    np.testing.assert_allclose(rows.load[held], 8.0, atol=0.05)
    assert not rows.lost.any(), "a train that stands asks nothing of the rail"
    angle = [m["ElectricalAngle"] for m in values(rows.frames, "Drive2_Motion")]
    assert len(set(angle[265:320])) == 1
    assert rows.speed[-1].min() > 2.0, "the train starts again"


@pytest.mark.parametrize("motor", MOTORS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_brakes_lock_the_wheel_on_leaves_while_its_motor_coasts(motor, sign):
    rated = MOTORS[motor].T_rated
    speed = 25.0 * MOTORS[motor].pole_pairs * sign
    leaves = {"at_s": 0.5, "drive": 1, "kind": "rail", "value": "leaves"}
    full = {"at_s": 0.4, "kind": "friction_brake", "depth": 0.6, "ramp_s": 0.3}
    table = {"motor": {"name": motor}, "motion": {"speed": speed}, "event": [leaves, full],
             "load": {"torque_nm": 0.2 * rated * sign}}  # fmt: skip
    seconds = 1.5 if motor != "traction_350kw" else 3.0
    rows = Rows(seconds, table)
    locked = rows.between(seconds - 0.2, seconds)
    assert not rows.speed[locked, 0].any()
    assert (sign * rows.speed[locked, 1]).min() > 2.0
    assert (sign * rows.speed).min() >= 0.0
    assert rows.lost[rows.between(0.8, seconds)].mean(axis=0).tolist() == [1.0, 0.0, 0.0]
    assert np.all(rows.depth[locked, 0] > 0.5)
    # The sliding wheel brakes the train less; what the motor measures says nothing of it.
    assert np.all(np.abs(rows.load[locked, 0]) < 0.4 * np.abs(rows.load[locked, 1]))
    amps = values(rows.frames, "Drive1_PhaseCurrents")[-50:]
    limit = 0.02 * MOTORS[motor].I_rated + 0.1
    assert max(abs(a[name]) for a in amps for name in ("Ia", "Ib", "Ic")) < limit


def test_a_motor_pulls_in_vain_against_a_locked_brake():
    plant = build()
    plant.p.brake_nm = [80.0, 0.0]
    advance(plant, 0.5, load=18.0)
    out = advance(plant, 0.2, load=18.0)
    assert not out[:, 0, c.SPEED].any()
    assert np.ptp(out[:, 0, c.ANGLE]) == 0.0
    np.testing.assert_allclose(out[:, 0, c.TORQUE], out[:, 0, c.COMMAND], atol=0.5)
    assert out[:, 0, c.TORQUE].min() > 18.0
    assert out[:, 0, c.LOAD].max() < -20.0, "it slides: the rail brakes the train"


def test_a_brake_too_weak_to_hold_only_drags():
    rows = Rows(2.5, {"load": {"torque_nm": 12.0}, "event": [brake(10.0, drive=1)]})
    late = rows.between(1.0, 2.5)
    np.testing.assert_allclose(rows.load[late, 0], rows.load[late, 1] - 10.0, atol=0.2)
    assert np.abs(rows.creep(1)[late]).max() < 0.01
    assert not rows.lost.any()
    torque = [[m["Torque"] for m in values(rows.frames, f"Drive{n}_Motion")] for n in (1, 2)]
    np.testing.assert_allclose(torque[0][100:], torque[1][100:], atol=0.3)


def test_a_weak_brake_lets_a_standing_wheel_go():
    plant = build(w_0=0.0, load=0.0)
    plant.p.brake_nm = [5.0, 0.0]
    out = advance(plant, 1.0, w_ref=5.0, load=0.0)
    assert out[-1, 0, c.SPEED] > 1.0
    assert out[:, 0, c.SPEED].min() >= 0.0


@pytest.mark.parametrize("w_0", [25.0, -25.0])
def test_momentum_and_energy_with_brakes_and_a_slide(w_0):
    nm = np.array([18.0, 18.0])
    plant = build(w_0=w_0, load=0.0)
    plant.p.brake_nm = nm
    out = advance(plant, 0.6, w_ref=w_0, rail="leaves")
    v = np.concatenate([[w_0], np.zeros(len(out))])
    impulse = np.cumsum(out[:, :, c.LOAD].mean(axis=1) * DT)
    v[1:] = w_0 + impulse / TRAIN.inertia(BENCH)
    assert plant.w_train == pytest.approx(v[-1], rel=1e-9)
    # Kinetic energy that is gone = work of the brakes + what the sliding contact takes.
    w = np.concatenate([np.full((1, 2), w_0), out[:, :, c.SPEED]])
    mean_w, mean_v = 0.5 * (w[1:] + w[:-1]), 0.5 * (v[1:] + v[:-1])[:, None]
    braked = (nm * np.abs(mean_w) * DT).sum()
    slid = (out[:, :, c.LOAD] * (mean_w - mean_v) * DT).sum()
    mass = 2 * TRAIN.inertia(BENCH)
    gone = 0.5 * mass * (w_0**2 - v[-1] ** 2) + 0.5 * BENCH.J * (2 * w_0**2 - (w[-1] ** 2).sum())
    assert slid > 100.0
    assert braked + slid == pytest.approx(gone, rel=5e-3)


def test_an_adhesion_loss_is_a_share_of_what_motor_and_brake_ask():
    rows = Rows(1.5, {"load": {"torque_nm": 12.0},
                      "event": [brake(18.0, at_s=0.3), loss(0.5, at_s=0.8)]})  # fmt: skip
    late = rows.between(1.0, 1.5)
    np.testing.assert_allclose(rows.load[late, 0], -9.0, atol=0.05)
    assert rows.lost[late].mean(axis=0).tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_allclose(rows.depth[late, 0], 0.5)


# --- the truth -------------------------------------------------------------------------------


@pytest.mark.parametrize("nm", [4.0, 6.0, 8.0, 12.0])
def test_lost_is_what_the_rail_cannot_give_to_the_brake(nm):
    # Leaves carry 6.9 Nm within 5 % creep at 5 m/s.
    rows = Rows(1.5, {"load": {"torque_nm": 0.0, "rail": "leaves"}, "event": [brake(nm)]})
    late = rows.between(0.8, 1.5)
    limit = available(RAILS["leaves"], 5.0, 0.05) * TRAIN.wheel_load_nm(BENCH)
    assert rows.lost[late].mean() == (nm > limit)
    if nm < limit:
        np.testing.assert_allclose(rows.load[late], -0.98 * nm, atol=0.1)
    else:
        assert np.all(np.abs(rows.load[late]) < nm)


@pytest.mark.parametrize("name", ["slide_no_limiter", "slide_slow_limiter", "slide_braked"])
@pytest.mark.parametrize("seed", some([0], [1, 2]))
def test_a_wheel_of_which_nothing_is_lost_does_not_slide(name, seed):
    s = draw(name, seed)
    simulation = Simulation(s, bind(CLASSIC, (1, 2, 3)))
    rows = Rows(s.duration_s, simulation=simulation)
    assert rows.lost.any(axis=0).sum() == 1
    train = np.median(rows.speed, axis=1)[:, None]
    creep = np.abs(rows.speed - train) / np.maximum(np.abs(train), 2.5)
    assert creep[rows.lost == 0].max() < 0.06
    assert creep[rows.lost == 1].max() > 0.05


# --- what is refused -------------------------------------------------------------------------


def test_a_brake_while_the_world_runs():
    event = parse({"title": "t", "duration_s": 1.0, "event": [brake(9.0, at_s=0.2)]}).event[0]
    rows = Rows(0.1, {"load": {"torque_nm": 12.0}})
    rows.simulation.inject(event)
    frames = []
    for tick in range(11, 61):
        frames += rows.simulation.step((), tick * 10_000_000)
    assert abs(values(frames, "Drive1_Motion")[-1]["Torque"]) < 0.5
    preset = Simulation(scenario(load={"kind": "preset"}), codec())
    with pytest.raises(ValueError, match="need a wheel on the rail"):
        preset.inject(event)


@pytest.mark.parametrize("name", ["runaway_gradual", "runaway_sudden", "slow_limiter"])
def test_shipped_runaways_run_away_where_no_gateway_helps(name):
    s = builtin(name)
    rows = Rows(s.duration_s, simulation=Simulation(s, codec()))
    who = s.event[0].drive
    assert rows.creep(who).max() > {"slow_limiter": 0.3}.get(name, 1.5)
    healthy = [d for d in (0, 1, 2) if d != who - 1]
    assert not rows.lost[:, healthy].any()
    assert rows.lost[:, who - 1].any()


@pytest.mark.parametrize(
    ("name", "who"), [("brake_all", None), ("brake_drag", None), ("brake_slide", 2),
                      ("brake_lock", 1)],
)  # fmt: skip
def test_shipped_brakes_lock_the_wheel_that_they_should(name, who):
    s = builtin(name)
    rows = Rows(s.duration_s, simulation=Simulation(s, codec()))
    for drive in (1, 2, 3):
        if drive == who:
            assert not rows.speed[-50:, drive - 1].any()
            assert rows.lost[-50:, drive - 1].all()
        else:
            assert rows.speed[-50:, drive - 1].min() > 5.0
            assert not rows.lost[:, drive - 1].any()
