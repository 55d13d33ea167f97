"""Motor model: the paper's numbers, derivatives by central differences, the coast law."""

import math

import numpy as np
import pytest

from estimators.models import pmsm
from estimators.models.pmsm import BENCH_MOTOR, BENCH_RATED, SUB_STEP_S
from tests.reference import motor_model


def random_states(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (n, 5)) * [40.0, 40.0, 400.0, math.pi, 40.0]


def central_differences(function, x):
    """d function / d x, (N, 5, 5), step by column as large as the column's own scale allows."""
    columns = []
    for j, h in enumerate([1e-3, 1e-3, 1e-2, 1e-5, 1e-3]):
        e = h * np.eye(5)[j]
        columns.append((function(x + e) - function(x - e)) / (2.0 * h))
    return np.stack(columns, axis=2)


def other_motor(n):
    """Friction and another Park constant, so that no entry is hidden by a zero."""
    return pmsm.repeat(pmsm.motors((0.05, 1e-3, 0.9, 3.0, 2.0, 0.4, 1.0)), n)


def test_coefficients_are_the_papers():
    """Effect of one step on unit states: theta_a, theta_b, theta_c, theta_e of eq. (12)-(13)."""
    one = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
    assert motor_model.step(BENCH_MOTOR, one, np.zeros((1, 2)), SUB_STEP_S)[0, 0] == pytest.approx(
        0.98990, abs=5e-6
    )
    speed = np.array([[0.0, 0.0, 1.0, 0.0, 0.0]])
    assert motor_model.step(BENCH_MOTOR, speed, np.zeros((1, 2)), SUB_STEP_S)[
        0, 1
    ] == pytest.approx(-0.007175, abs=5e-7)
    volt = motor_model.step(BENCH_MOTOR, np.zeros((1, 5)), np.array([[1.0, 0.0]]), SUB_STEP_S)
    assert volt[0, 0] == pytest.approx(0.03608, abs=5e-6)
    i_q = np.array([[0.0, 1.0, 0.0, 0.0, 0.0]])
    assert motor_model.step(BENCH_MOTOR, i_q, np.zeros((1, 2)), SUB_STEP_S)[0, 2] == pytest.approx(
        0.01492, abs=5e-6
    )


@pytest.mark.parametrize("par", [pmsm.repeat(BENCH_MOTOR, 50), other_motor(50)])
def test_all_25_entries_of_the_jacobian(par):
    x = random_states(50)
    u = np.full((50, 2), 13.0)
    want = central_differences(lambda z: motor_model.step(par, z, u, SUB_STEP_S), x)
    got = motor_model.jacobian(par, x, SUB_STEP_S)
    assert got == pytest.approx(want, rel=1e-7, abs=1e-8)


def test_the_jacobian_has_the_load_row_and_column_the_paper_leaves_out():
    F = motor_model.jacobian(BENCH_MOTOR, random_states(1), SUB_STEP_S)[0]
    assert F[2, 4] == pytest.approx(-4.0 * SUB_STEP_S / 0.04)
    assert F[4].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("par", [pmsm.repeat(BENCH_MOTOR, 50), other_motor(50)])
@pytest.mark.parametrize("tau_s", [SUB_STEP_S, 2e-3, 0.02])
def test_coast_jacobian(par, tau_s):
    x = random_states(50, seed=1)
    tau = np.full(50, tau_s)
    want = central_differences(lambda z: motor_model.coast(par, z, tau), x)
    assert motor_model.coast_jacobian(par, x, tau) == pytest.approx(want, rel=1e-6, abs=1e-7)


def test_coasting_keeps_rotor_frame_currents_and_integrates_the_mechanics():
    par = pmsm.repeat(BENCH_MOTOR, 20)
    x = random_states(20, seed=2)
    tau = np.full(20, 4e-3)
    got = motor_model.coast(par, x, tau)

    def rotor_frame(z):
        return (z[:, 0] + 1j * z[:, 1]) * np.exp(-1j * z[:, 3])

    assert rotor_frame(got) == pytest.approx(rotor_frame(x), abs=1e-10)
    acceleration = 4.0 / 0.04 * (motor_model.torque(par, x) - x[:, 4])
    assert got[:, 2] == pytest.approx(x[:, 2] + 4e-3 * acceleration)
    assert got[:, 3] == pytest.approx(x[:, 3] + 4e-3 * 0.5 * (x[:, 2] + got[:, 2]))
    assert (got[:, 4] == x[:, 4]).all()


@pytest.mark.parametrize("n_sub", [1, 2, 16, 40])
def test_the_turning_voltage_keeps_its_mean_and_turns_with_the_rotor(n_sub):
    w = np.array([0.0, 1e-9, 3.0, -250.0, 1300.0, -1.39 * 2.0 / (n_sub * SUB_STEP_S)])
    w = w[np.abs(0.5 * n_sub * w * SUB_STEP_S) <= 1.4]
    u = np.stack([np.linspace(-90.0, 120.0, len(w)), np.full(len(w), 40.0)], axis=1)
    v = motor_model.turning(u, w, n_sub, SUB_STEP_S)
    assert v.shape == (len(w), n_sub, 2)
    assert v.mean(axis=1) == pytest.approx(u)
    z = v[..., 0] + 1j * v[..., 1]
    assert z[:, 1:] == pytest.approx(z[:, :-1] * np.exp(1j * w * SUB_STEP_S)[:, None])


@pytest.mark.parametrize("w", [1401.0, -5000.0, math.pi / (8 * SUB_STEP_S), math.nan, math.inf])
def test_a_voltage_that_turns_too_far_is_held(w):
    u = np.array([[12.0, -7.0]])
    v = motor_model.turning(u, np.array([w]), 16, SUB_STEP_S)
    assert v == pytest.approx(np.tile(u[:, None], (1, 16, 1)))


def test_torque_is_power_over_speed():
    """k_p (u_emf . i) = T w_m, whatever the angle: the Park constant and the pole pairs agree."""
    x = random_states(30, seed=3)
    par = pmsm.repeat(BENCH_MOTOR, 30)
    emf = 0.1989 * x[:, 2] * 1j * np.exp(1j * x[:, 3])
    power = 1.5 * (emf.conj() * (x[:, 0] + 1j * x[:, 1])).real
    assert motor_model.torque(par, x) * x[:, 2] / 4.0 == pytest.approx(power)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(math.pi, math.pi), (-math.pi, math.pi), (0.0, 0.0), (7.0, 7.0 - 2 * math.pi), (-3.0, -3.0)],
)
def test_wrap(angle, wrapped):
    assert motor_model.wrap(np.array([angle])) == pytest.approx([wrapped])


@pytest.mark.parametrize(
    "row",
    [
        (0.28, 0.0, 0.2, 4.0, 0.04, 0.0, 1.5),
        (-0.1, 3e-3, 0.2, 4.0, 0.04, 0.0, 1.5),
        (0.28, 3e-3, 0.2, 4.0, math.nan, 0.0, 1.5),
    ],
)
def test_unphysical_motors_are_refused(row):
    with pytest.raises(ValueError, match="must be"):
        pmsm.motors(row)


def test_table_and_repeat_keep_order():
    par = pmsm.motors((1, 2, 3, 4, 5, 6, 7), (8, 9, 10, 11, 12, 13, 14))
    assert pmsm.table(pmsm.repeat(par, 2))[:, 0].tolist() == [1, 8, 1, 8]
    assert pmsm.table(par)[1].tolist() == [8, 9, 10, 11, 12, 13, 14]


def test_default_noise_of_the_bench_motor_and_its_scaling():
    noise = pmsm.default_noise(BENCH_MOTOR, BENCH_RATED)
    assert noise.Q[0] == pytest.approx([1e-4, 1e-4, 1e-5, 1e-6, 0.1])
    assert noise.R[0] == pytest.approx([2e-4 + 0.02**2 / 12.0] * 2)
    assert noise.coast == pytest.approx([25.0])
    # Ten times current and torque with ten times the inertia: the same acceleration.
    big = BENCH_MOTOR._replace(J=BENCH_MOTOR.J * 10.0)
    scaled = pmsm.default_noise(big, pmsm.Rated(np.array([250.0]), np.array([300.0])), 250e-6)
    assert scaled.Q[0] == pytest.approx([2e-2, 2e-2, 2e-5, 2e-6, 20.0])
    assert scaled.coast == pytest.approx([2500.0])
