"""Drives that are unlike: motors off their data sheet, shares, wheels, sensors, an open phase."""

import math

import numpy as np
import pytest

from sim.drive_spread import Variety
from sim.ground_truth import COLUMNS
from sim.physics import plant as c
from sim.physics.adhesion import RAILS
from sim.physics.plant import BENCH, MOTORS, TRACTION_350KW, TRAIN, TRAINS, Plant, parameters
from sim.simulation import Simulation
from tests.simrun import codec, run, scenario, values
from tests.unit.test_sim_plant import run as advance

QUIET = {"sensors": {"current_noise_var": 0.0}}
STEADY = {"load": {"kind": "preset", "torque_nm": 18.0}, "motion": {"speed": 100.0}}


def variety(motor=BENCH, **table):
    return Variety(scenario(**table), motor)


def rows(simulation, drive):
    return [r for r in simulation.truth_rows() if r.drive == drive]


def test_without_tables_all_drives_are_the_data_sheet():
    v = variety()
    np.testing.assert_array_equal(v.p, parameters(BENCH, 3))
    np.testing.assert_array_equal(v.share(1.0), 1.0)
    np.testing.assert_array_equal(v.offset, 0.0)
    np.testing.assert_array_equal(v.gain, 1.0)
    np.testing.assert_array_equal(v.torque_scale, 1.0)


def test_factors_are_given_or_drawn_from_the_seed():
    v = variety(mismatch={"R_s": [1.2, 0.8, 1.0], "psi_pm": 0.9})
    np.testing.assert_allclose(v.p.R_s, BENCH.R_s * np.array([1.2, 0.8, 1.0]))
    np.testing.assert_allclose(v.p.psi_pm, BENCH.psi_pm * 0.9)
    np.testing.assert_allclose(v.p.psi_pm_control, BENCH.psi_pm)
    table = {"R_s_within": 0.2, "L_s_within": 0.05, "psi_pm_within": 0.03}
    one, same, other = (variety(seed=seed, mismatch=table) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.p, same.p)
    for name, limit in (("R_s", 0.2), ("L_s", 0.05), ("psi_pm", 0.03)):
        off = one.p[name] / getattr(BENCH, name) - 1.0
        assert np.all(np.abs(off) <= limit)
        assert len(set(off.tolist())) == 3
        assert not np.any(one.p[name] == other.p[name])
    drawn = np.array([variety(seed=s, mismatch=table).p.R_s for s in range(40)]) / BENCH.R_s
    assert drawn.min() < 0.82
    assert drawn.max() > 1.18


def test_sensors_of_each_phase_have_their_own_offset_and_gain():
    v = variety(sensors={"current_offset_within_a": 0.1, "current_gain_within": 0.02,
                         "current_offset_a": 1.0})  # fmt: skip
    assert v.offset.shape == v.gain.shape == (3, 3)
    assert np.all(np.abs(v.offset - 1.0) <= 0.1)
    assert len(set(v.offset.ravel().tolist())) == 9
    assert 0.98 <= v.gain.min() < v.gain.max() <= 1.02


def test_curves_swell_and_return():
    curve = {"drive": 1, "at_s": 1.0, "for_s": 2.0, "amount": 0.08}
    v = variety(load={"share": [1.1, 1.0, 1.0], "curve": [curve]})
    assert v.share(0.9)[0] == pytest.approx(1.1)
    assert v.share(2.0)[0] == pytest.approx(1.1 * 1.08)
    assert v.share(3.0)[0] == pytest.approx(1.1)
    np.testing.assert_array_equal(v.share(2.0)[1:], 1.0)


@pytest.mark.parametrize("kind", ["preset", "rail"])
def test_shares_are_in_the_load_and_not_in_the_command(kind):
    table = {**QUIET, **STEADY, "load": {"kind": kind, "torque_nm": 18.0, "share": [1.1, 1.0, 0.9]}}
    simulation = Simulation(scenario(**table), codec())
    out = run(simulation, 2.0)
    truth = simulation.truth_rows()[-3:]
    np.testing.assert_allclose([r.load_nm for r in truth], [19.8, 18.0, 16.2], atol=0.1)
    for node in (1, 2, 3):
        assert values(out, f"Drive{node}_Status")[-1]["TorqueCommand"] == pytest.approx(18, abs=0.1)
    assert [r.lost for r in truth] == [0, 0, 0]


@pytest.mark.parametrize("kind", ["preset", "rail"])
def test_a_smaller_wheel_turns_faster(kind):
    table = {**QUIET, "load": {"kind": kind, "wheel": [1.0, 0.98, 1.02]}}
    simulation = Simulation(scenario(**table), codec())
    run(simulation, 1.5)
    last = simulation.truth_rows()[-3:]
    speed = np.array([r.speed_rad_s for r in last])
    np.testing.assert_allclose(speed / speed[0], [1.0, 1 / 0.98, 1 / 1.02], rtol=2e-3)
    assert [r.lost for r in last] == [0, 0, 0]


def test_weaker_magnets_need_more_current_and_are_not_believed():
    table = {**QUIET, **STEADY, "mismatch": {"psi_pm": [1.0, 0.9, 1.0]}}
    out = run(Simulation(scenario(**table), codec()), 1.0)
    amps = [values(out, f"Drive{n}_Status")[-1]["Irms"] for n in (1, 2)]
    assert amps[1] / amps[0] == pytest.approx(1 / 0.9, rel=5e-3)
    told = [values(out, f"Drive{n}_Motion")[-1]["Torque"] for n in (1, 2)]
    assert told == [pytest.approx(18.0, abs=0.2), pytest.approx(20.0, abs=0.2)]


def test_on_the_rail_weaker_magnets_deliver_less_than_commanded():
    table = {**QUIET, "mismatch": {"psi_pm": [0.9, 1.0, 1.0]}}
    simulation = Simulation(scenario(**table), codec())
    out = run(simulation, 2.0)
    load = [r.load_nm for r in simulation.truth_rows()[-3:]]
    assert load[0] / load[1] == pytest.approx(0.9, rel=5e-3)
    told = values(out, "Drive1_Motion")[-1]["Torque"]
    assert told == pytest.approx(values(out, "Drive1_Status")[-1]["TorqueCommand"], abs=0.3)


@pytest.mark.parametrize("kind", ["preset", "rail"])
def test_an_open_phase_carries_nothing_and_torque_pulsates(kind):
    event = {"at_s": 0.5, "for_s": 0.5, "drive": 2, "kind": "phase_open"}
    table = {**QUIET, "load": {"kind": kind, "torque_nm": 12.0}, "event": [event]}
    simulation = Simulation(scenario(**table), codec())
    out = run(simulation, 1.6)
    amps = values(out, "Drive2_PhaseCurrents")
    inside = [a for a in amps if 0.505 < a["t_s"] < 0.999]
    assert max(abs(a["Ia"]) for a in inside) < 1e-9
    assert max(abs(a["Ib"] + a["Ic"]) for a in inside) < 0.05
    assert max(abs(a["Ib"]) for a in inside) > 5.0
    torque = [m["Torque"] for m in values(out, "Drive2_Motion") if 0.6 < m["t_s"] < 0.99]
    assert max(torque) > 15.0
    assert min(torque) < 5.0
    # The others do not notice, and the drive comes back; no adhesion was lost.
    assert max(abs(a["Ia"]) for a in values(out, "Drive1_PhaseCurrents")) > 5.0
    mine = rows(simulation, 2)
    assert mine[-1].load_nm == pytest.approx(12.0, abs=0.5)
    assert not any(r.lost for r in mine)
    after = [a["Ia"] for a in amps if a["t_s"] > 1.3]
    assert max(np.abs(after)) > 5.0


def test_the_bytes_do_not_depend_on_how_time_is_cut():
    table = {
        "mismatch": {"R_s_within": 0.2}, "sensors": {"current_offset_within_a": 0.1},
        "load": {"share_within": 0.1, "wheel_within": 0.01,
                 "curve": [{"drive": 1, "at_s": 0.1, "for_s": 0.3, "amount": 0.1}]},
        "event": [{"at_s": 0.2, "for_s": 0.1, "drive": 2, "kind": "phase_open"}],
    }  # fmt: skip
    whole = run(Simulation(scenario(**table), codec()), 0.4)
    pieces = run(Simulation(scenario(**table), codec()), 0.4, 3_300_000)
    assert pieces == whole[: len(pieces)]


def test_depth_is_what_the_rail_does_not_carry():
    event = {"at_s": 0.5, "for_s": 0.5, "drive": 1, "kind": "adhesion_loss", "depth": 0.6,
             "ramp_s": 0.1}  # fmt: skip
    simulation = Simulation(scenario(**STEADY, event=[event]), codec())
    run(simulation, 1.2)
    mine = rows(simulation, 1)
    at = {round(r.t_s, 2): r for r in mine}
    assert at[0.55].depth == pytest.approx(0.3)
    assert at[0.70].depth == pytest.approx(0.6)
    assert at[1.10].depth == 0.0
    assert all((r.depth > 0) == bool(r.lost) for r in mine)
    assert len(at[0.7].text()) == len(COLUMNS)


@pytest.mark.parametrize("torque", [22.0, -22.0])
def test_lost_on_the_rail_begins_and_ends_with_the_rail(torque):
    event = {"at_s": 1.0, "for_s": 0.5, "drive": "all", "kind": "rail", "value": "leaves"}
    table = {"load": {"kind": "rail", "torque_nm": torque}, "event": [event],
             "motion": {"speed": 120.0, "effort_nm": 25.0}}  # fmt: skip
    simulation = Simulation(scenario(**table), codec())
    run(simulation, 2.5)
    drive_rows = rows(simulation, 1)
    lost = [r.t_s for r in drive_rows if r.lost]
    assert (lost[0], lost[-1]) == (pytest.approx(1.0, abs=0.011), pytest.approx(1.5, abs=0.011))
    assert len(lost) == pytest.approx(50, abs=2)
    deep = [r.depth for r in drive_rows if 1.05 < r.t_s < 1.49]
    assert min(deep) > 0.65
    assert max(deep) < 0.75


def test_the_driver_asks_for_no_more_than_his_effort():
    event = {"at_s": 0.5, "drive": "all", "kind": "rail", "value": "leaves"}
    for effort, most in ((20.0, 20.0), (None, 45.0)):
        motion = {"speed": 100.0} | ({"effort_nm": effort} if effort else {})
        out = run(Simulation(scenario(motion=motion, event=[event]), codec()), 4.0)
        command = max(v["TorqueCommand"] for v in values(out, "Drive1_Status"))
        assert command == pytest.approx(most, abs=0.1)


def test_the_350_kw_motor_meets_its_nameplate():
    m = TRACTION_350KW
    w_e = 2 * math.pi * 140
    power = m.T_rated * w_e / m.pole_pairs
    i_q = m.T_rated / (m.k_p * m.pole_pairs * m.psi_pm)
    u = math.hypot(w_e * m.L_s * i_q, w_e * m.psi_pm + m.R_s * i_q)
    assert power == pytest.approx(350e3, rel=2e-3)
    assert i_q / math.sqrt(2) == pytest.approx(170.0, rel=2e-3)
    assert u * math.sqrt(1.5) == pytest.approx(1443.0, rel=2e-3)
    assert m.I_rated / math.sqrt(2) == pytest.approx(170.0, rel=2e-3)


@pytest.mark.parametrize("torque", [796.0, -796.0, 1194.0])
def test_the_350_kw_motor_holds_its_torque_at_140_hz(torque):
    m = TRACTION_350KW
    w_m = 2 * math.pi * 140 / m.pole_pairs
    plant = Plant(m, np.arange(3.0), on_rail=False, w_0=w_m, load_0=torque)
    out = advance(plant, 0.4, w_ref=w_m, load=torque)[-400:]
    np.testing.assert_allclose(out[..., c.TORQUE], torque, rtol=2e-3)
    np.testing.assert_allclose(out[..., c.SPEED], w_m, rtol=1e-3)
    assert np.hypot(out[..., c.U_ALPHA], out[..., c.U_BETA]).max() < m.U_dc / math.sqrt(3)


def test_its_train_is_sensible():
    m, train = MOTORS["traction_350kw"], TRAINS["traction_350kw"]
    speed = 2 * math.pi * 140 / m.pole_pairs * train.wheel_radius_m
    assert 55 < speed < 70  # m/s
    assert train.mass_kg * m.T_rated / BENCH.T_rated == pytest.approx(25e3, rel=1e-3)
    ratio = train.inertia(m) / m.J
    assert ratio == pytest.approx(TRAIN.inertia(BENCH) / BENCH.J, rel=0.1)
    share = m.T_rated / train.wheel_load_nm(m)
    assert share == pytest.approx(BENCH.T_rated / TRAIN.wheel_load_nm(BENCH), rel=0.01)
    plant = Plant(m, np.arange(3.0), on_rail=True, w_0=100.0, load_0=600.0, train=train)
    out = advance(plant, 1.0, w_ref=100.0, load=600.0)[-400:]
    np.testing.assert_allclose(out[..., c.LOAD], 600.0, rtol=0.01)
    assert not plant.slips(0, RAILS["dry"])
    assert plant.slips(0, RAILS["wet"])
    assert plant.shortage(0, RAILS["wet"], 600.0) == pytest.approx(0.12, abs=0.05)
