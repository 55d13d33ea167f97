import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.physics import plant as c
from sim.physics.adhesion import RAILS, SPEED_FLOOR_M_S
from sim.physics.plant import BENCH, DT, MOTORS, TRAIN, Plant, QuasiStatic, rail_array
from sim.records import ffi, lib, pointer
from tests.reference import plant as reference


def run(plant, seconds, *, w_ref, load, carry=None, cut=None, rails=None, drives=3):
    """Advance; carry, cut, rails are functions of time giving (N,) or a list of Rail."""
    blocks = []
    for k in range(round(seconds * 100)):
        t = k * 0.01
        n = 80
        share = np.ones(drives) if carry is None else np.asarray(carry(t), float)
        down = np.zeros(drives, bool) if cut is None else np.asarray(cut(t), bool)
        curve = rail_array([RAILS["dry"]] * drives if rails is None else rails(t))
        blocks.append(
            plant.advance(
                np.full(n, w_ref), np.zeros(n), np.full(n, load), np.tile(share, (n, 1)),
                np.tile(down, (n, 1)), np.tile(curve, (n, 1, 1)),
            )
        )  # fmt: skip
    return np.concatenate(blocks)


def build(*, on_rail, w_0=25.0, load=18.0, drives=3, motor=BENCH):
    return Plant(motor, np.arange(float(drives)), on_rail=on_rail, w_0=w_0, load_0=load)


def columns(records):
    """(N, fields) of numbers, as the reference has them."""
    return np.array(records.tolist(), float)


def integrate(plant, u_a, u_b, steps, **contact):
    """The first drive over so many parts of a control period."""
    contact = {"rail": RAILS["dry"], "radius_m": 0.2, "weight_nm": 94.0, "limit_nm": 1e30,
               "speed_floor_m_s": SPEED_FLOOR_M_S, **contact}  # fmt: skip
    lib.sim_integrate(
        pointer("struct sim_motor", plant.p), ffi.new("struct sim_contact *", contact), u_a, u_b,
        DT / steps, steps, pointer("struct sim_drive", plant.drives),
    )  # fmt: skip


def dq_rates(_t, y, u_a, u_b, m, load):
    """The same machine in rotor coordinates: an independent statement of the equations."""
    i_d, i_q, w_m, theta = y
    w_e = m.pole_pairs * w_m
    u_d = u_a * math.cos(theta) + u_b * math.sin(theta)
    u_q = u_b * math.cos(theta) - u_a * math.sin(theta)
    torque = m.k_p * m.pole_pairs * m.psi_pm * i_q
    return [
        (u_d - m.R_s * i_d + w_e * m.L_s * i_q) / m.L_s,
        (u_q - m.R_s * i_q - w_e * (m.L_s * i_d + m.psi_pm)) / m.L_s,
        (torque - load - m.B * w_m) / m.J,
        w_e,
    ]


@pytest.mark.parametrize(
    "motor", [*MOTORS.values(), replace(BENCH, B=0.2)], ids=[*MOTORS, "friction"]
)
@pytest.mark.parametrize("w_m", [-60.0, 5.0, 62.0])
def test_drive_agrees_with_scipy_in_dq(motor, w_m):
    rng = np.random.default_rng(3)
    plant = build(on_rail=False, w_0=w_m, drives=1, motor=motor)
    drive = plant.drives[0]
    drive.i_alpha, drive.i_beta, drive.theta_e = 3.0, -7.0, 1.2
    sin, cos = math.sin(1.2), math.cos(1.2)
    y = np.array([3.0 * cos - 7.0 * sin, -7.0 * cos - 3.0 * sin, w_m, 1.2])
    for _ in range(40):
        u_a, u_b = rng.uniform(-100, 100, 2)
        load = rng.uniform(-30, 30)
        integrate(plant, u_a, u_b, 1, load_nm=load)
        y = solve_ivp(dq_rates, (0, DT), y, args=(u_a, u_b, motor, load), rtol=1e-12, atol=1e-12).y[
            :, -1
        ]
    i_a = y[0] * math.cos(y[3]) - y[1] * math.sin(y[3])
    i_b = y[0] * math.sin(y[3]) + y[1] * math.cos(y[3])
    np.testing.assert_allclose(drive.tolist()[:3], [i_a, i_b, y[2]], rtol=1e-6, atol=1e-6)
    assert math.cos(drive.theta_e - y[3]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("w_m", [25.0, 0.02, 0.0, -0.02])
@pytest.mark.parametrize("brake", [2.0, 60.0])
def test_the_brake_equals_the_reference(w_m, brake):
    """To the bit: also where it stops the wheel, and where it holds it or cannot."""
    plant = build(on_rail=True, w_0=w_m, drives=1)
    plant.p.brake_nm = brake
    x, p = columns(plant.drives)[0], columns(plant.p)[0]
    curve = rail_array([RAILS["dry"]])[0]
    for _ in range(5):
        integrate(plant, 3.0, -2.0, 4, v_m_s=0.1, on_rail=1)
        reference.integrate(x, 3.0, -2.0, p, DT / 4, 4, True, 0.0, 0.1, 0.2, 94.0, curve, 1e30)
        assert columns(plant.drives)[0].tolist() == x.tolist()


@pytest.mark.parametrize("seed", range(18))
def test_the_plant_equals_the_reference(seed):
    """To the bit: every motor, slip limiter and way to load, brakes, open phases, poor rails."""
    rng = np.random.default_rng(seed)
    n, on_rail, motor = 20, seed % 2 == 1, list(MOTORS.values())[seed % 3]
    plant = build(on_rail=on_rail, w_0=25.0 * (seed % 5 - 1), motor=motor, drives=2)
    c.set_slip_limiter(plant.p, list(c.SLIP_LIMITERS.values())[seed % 3])
    plant.p.share, plant.p.wheel = [0.9, 1.1], [1.0, 0.98]
    plant.p.effort_nm *= seed < 15  # the last ones coast
    x, p = columns(plant.drives), columns(plant.p)
    train = np.array([plant.w_train, 18.0, 18.0])
    for k in range(10):
        p[:, reference.BRAKE] = [rng.choice([0.0, 20.0]), 20.0 * (k % 3)]
        p[:, reference.PHASE_OPEN] = rng.random(2) < 0.2
        plant.p.brake_nm, plant.p.phase_a_open = p[:, reference.BRAKE], p[:, reference.PHASE_OPEN]
        x[:, 2] += rng.choice([0.0, 20.0, -20.0], 2)  # wheels that run away
        plant.drives.w_m = x[:, 2]
        names = rng.choice(list(RAILS), (n, 2))
        args = (
            np.full(n, rng.uniform(-60, 60)), rng.uniform(-3, 3, n),
            np.full(n, rng.choice([0.0, 18.0, -25.0])), rng.choice([1.0, 0.4, 0.0], (n, 2)),
            rng.random((n, 2)) < 0.2, np.array([[RAILS[name] for name in row] for row in names]),
        )  # fmt: skip
        out = plant.advance(*args)
        twin = np.empty_like(out)
        reference.advance(
            x, train, p, on_rail, 4 if on_rail else 1, motor.U_dc, *args, TRAIN.wheel_radius_m,
            plant.wheel_load_nm, TRAIN.inertia(motor), twin,
        )  # fmt: skip
        np.testing.assert_array_equal(out, twin)
        assert plant.demand_nm == train[2]


@pytest.mark.parametrize("on_rail", [False, True])
@pytest.mark.parametrize(("w_m", "load"), [(25.0, 18.0), (-60.0, 12.0), (40.0, -25.0), (10.0, 8.0)])
def test_healthy_drive_settles_to_its_load(on_rail, w_m, load):
    out = run(build(on_rail=on_rail, w_0=w_m, load=load), 2.0, w_ref=w_m, load=load)
    end = out[-800:].mean(axis=0)
    np.testing.assert_allclose(end[:, c.TORQUE], load, atol=0.1)
    np.testing.assert_allclose(end[:, c.LOAD], load, atol=0.1)
    np.testing.assert_allclose(end[:, c.COMMAND], load, atol=0.1)
    np.testing.assert_allclose(end[:, c.SPEED], w_m, rtol=0.03)


@pytest.mark.parametrize("on_rail", [False, True])
def test_energy_balance(on_rail):
    # Energy in at the terminals = copper loss + change of magnetic and kinetic energy + load work.
    m = BENCH
    plant = build(on_rail=on_rail)
    first = run(plant, 0.5, w_ref=25.0, load=18.0)[-1]
    out = run(plant, 1.0, w_ref=25.0, load=18.0, carry=lambda t: [0.2 if t > 0.3 else 1, 1, 1])
    before = np.concatenate([first[None], out[:-1]])
    mean_i = 0.5 * (before + out)[:, :, :2]
    power_in = 1.5 * (out[:, :, 2:4] * mean_i).sum(axis=2)
    square = (before[:, :, :2] ** 2 + before[:, :, :2] * out[:, :, :2] + out[:, :, :2] ** 2) / 3
    copper = 1.5 * m.R_s * square.sum(axis=2)
    speed = 0.5 * (before + out)[:, :, c.SPEED]
    work = 0.5 * (before + out)[:, :, c.LOAD] * speed
    stored = 0.75 * m.L_s * (out[-1, :, :2] ** 2 - first[:, :2] ** 2).sum(axis=1)
    kinetic = 0.5 * m.J * (out[-1, :, c.SPEED] ** 2 - first[:, c.SPEED] ** 2)
    balance = ((power_in - copper - work) * DT).sum(axis=0) - stored - kinetic
    assert np.all(np.abs(balance) < 0.003 * (power_in * DT).sum(axis=0))


def test_momentum_of_the_train():
    plant = build(on_rail=True)
    out = run(plant, 1.5, w_ref=25.0, load=18.0, carry=lambda t: [0.0 if t > 0.2 else 1, 1, 1])
    impulse = ((out[:, :, c.LOAD].mean(axis=1) - 18.0) * DT).sum()
    change = (plant.w_train - 25.0) * TRAIN.inertia(BENCH)
    assert impulse == pytest.approx(change, rel=1e-6)
    assert change < -1.0


@pytest.mark.parametrize("on_rail", [False, True])
@pytest.mark.parametrize("depth", [0.3, 0.75, 1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_adhesion_loss_leaves_its_share_and_the_wheel_stays(on_rail, depth, sign):
    plant = build(on_rail=on_rail, load=18.0 * sign)
    out = run(plant, 1.0, w_ref=25.0, load=18.0 * sign,
              carry=lambda t: [1 - depth if t >= 0.5 else 1, 1, 1])  # fmt: skip
    late = out[-1600:]
    share = late[:, 0, c.LOAD] / late[:, 0, c.COMMAND]
    np.testing.assert_allclose(share, 1 - depth, atol=0.01)
    np.testing.assert_allclose(late[:, 1, c.LOAD], late[:, 1, c.COMMAND], rtol=0.02)
    # Own backstop: within a few per cent of the train's speed, overshoot included.
    train = out[:, 1, c.SPEED]
    assert np.all(np.abs(out[:, 0, c.SPEED] - train) < 0.15 * 25.0)
    assert np.all(np.abs(late[:, 0, c.SPEED] - train[-1600:]) < 0.08 * 25.0)


@pytest.mark.parametrize("on_rail", [False, True])
def test_cut_drive_grips_again_below_depth_07(on_rail):
    plant = build(on_rail=on_rail)
    out = run(plant, 1.5, w_ref=25.0, load=18.0, carry=lambda t: [0.4 if t >= 0.5 else 1, 1, 1],
              cut=lambda t: [t >= 0.8, False, False])  # fmt: skip
    slipping, cut = out[int(0.75 * 8000), 0], out[-1, 0]
    assert slipping[c.LOAD] < 0.45 * slipping[c.COMMAND]
    assert cut[c.COMMAND] == pytest.approx(0.3 * plant.demand_nm, rel=0.02)
    assert cut[c.LOAD] == pytest.approx(cut[c.COMMAND], rel=0.05)


def test_limiter_ramps():
    plant = build(on_rail=False)
    out = run(plant, 2.0, w_ref=25.0, load=18.0, cut=lambda t: [0.5 <= t < 0.8, False, False])
    share = out[:, 0, c.COMMAND] / 18.0
    time = (np.arange(len(share)) + 1) * DT
    assert share[time <= 0.5].min() == 1.0
    assert share[np.searchsorted(time, 0.6)] == pytest.approx(0.3, abs=1e-3)
    assert share[np.searchsorted(time, 0.55)] == pytest.approx(0.65, abs=5e-3)
    assert share[np.searchsorted(time, 1.3)] == pytest.approx(0.65, abs=5e-3)
    assert share[np.searchsorted(time, 1.79)] < 1.0
    assert share[np.searchsorted(time, 1.81)] == 1.0


def test_rails_decide_who_slips():
    plant = build(on_rail=True, load=26.0)
    out = run(plant, 1.0, w_ref=25.0, load=26.0,
              rails=lambda _: [RAILS["dry"], RAILS["wet"], RAILS["leaves"]])  # fmt: skip
    load = out[-800:, :, c.LOAD].mean(axis=0)
    assert load[0] > 26.0
    assert 18.0 < load[1] < 22.0
    assert 5.0 < load[2] < 9.0
    assert not plant.slips(0, RAILS["dry"])
    assert plant.slips(1, RAILS["wet"])
    assert plant.slips(2, RAILS["leaves"])


def test_preset_load_never_slips():
    plant = build(on_rail=False)
    assert not plant.slips(0, RAILS["leaves"])


def test_braking_mirrors_driving():
    drive = run(build(on_rail=True, load=18.0), 0.5, w_ref=25.0, load=18.0)
    back = Plant(BENCH, -np.arange(3.0), on_rail=True, w_0=-25.0, load_0=-18.0)
    mirror = run(back, 0.5, w_ref=-25.0, load=-18.0)
    for column in (c.SPEED, c.LOAD, c.TORQUE, c.COMMAND):
        np.testing.assert_allclose(drive[..., column], -mirror[..., column], atol=1e-9)


def test_voltage_stays_within_the_dc_link():
    plant = build(on_rail=False, w_0=250.0, load=40.0)
    out = run(plant, 0.3, w_ref=300.0, load=40.0)
    size = np.hypot(out[..., c.U_ALPHA], out[..., c.U_BETA])
    assert np.all(size[1:] <= out[:-1, :, c.U_DC] / math.sqrt(3) + 1e-9)
    assert size.max() > 0.95 * BENCH.U_dc / math.sqrt(3)


def test_quasi_static_agrees_with_the_full_plant():
    full = run(build(on_rail=False), 1.0, w_ref=25.0, load=18.0)[-1]
    slow = QuasiStatic(BENCH, full[:, c.ANGLE], 18.0)
    row = slow.advance(25.0, 18.0, np.ones(3), np.zeros(3, bool))
    for a, b in ((c.I_ALPHA, c.I_BETA), (c.U_ALPHA, c.U_BETA)):
        np.testing.assert_allclose(
            np.hypot(row[:, a], row[:, b]), np.hypot(full[:, a], full[:, b]), rtol=5e-3
        )
    np.testing.assert_allclose(row[:, c.TORQUE], full[:, c.TORQUE], rtol=1e-3)
    down = slow.advance(25.0, 18.0, np.array([1, 0.2, 1]), np.array([True, False, False]))
    assert down[0, c.COMMAND] == pytest.approx(18.0 * 0.93)
    assert down[1, c.LOAD] == pytest.approx(3.6)
