"""Unscented Kalman filter: filterpy, linear limit, angle across pi, broken covariances."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

from estimators.models.pmsm import SUB_STEP_S
from tests.reference import ekf, motor_model, ukf
from tests.unit.test_est_ekf import bench, start


@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_equals_filterpy_over_many_steps(kappa):
    par, noise = bench(1)
    x, P = start(1, 3)
    x[0, 3] = 3.1  # close to the seam
    points = JulierSigmaPoints(5, kappa)
    other = UnscentedKalmanFilter(
        5,
        2,
        SUB_STEP_S,
        hx=lambda z: z[:2],
        fx=lambda z, dt, u: motor_model.step(par, z[None], u[None], dt)[0],
        points=points,
    )
    other.x, other.P = x[0].copy(), P[0].copy()
    other.Q, other.R = np.diag(noise.Q[0]), np.diag(noise.R[0])
    rng = np.random.default_rng(5)
    for _ in range(150):
        u, y = rng.normal(size=2) * 20.0, x[0, :2] + rng.normal(size=2)
        x, P, ok = ukf.predict(par, noise, x, P, u[None], 2, SUB_STEP_S, kappa)
        x, P, _ = ekf.update(noise, x, P, y[None])
        assert ok.all()
        v = motor_model.turning(u[None], other.x[None, 2], 2, SUB_STEP_S)[0]
        other.predict(u=v[0])
        other.predict(u=v[1])
        other.update(y)
        assert motor_model.wrap(x[:, 3] - other.x[3]) == pytest.approx([0.0], abs=1e-9)
        assert np.delete(x[0], 3) == pytest.approx(np.delete(other.x, 3), rel=1e-9, abs=1e-9)
        assert P[0] == pytest.approx(other.P, rel=1e-9, abs=1e-9)


def test_linear_limit_is_the_ekf():
    """Without magnet flux the motor is linear: EKF and UKF agree, and so both with the KF."""
    par, noise = bench(3)
    par = par._replace(psi_f=np.zeros(3))
    x, P = start(3, 4)
    u = np.full((3, 2), 9.0)
    x_ekf, P_ekf = ekf.predict(par, noise, x, P, u, 8, SUB_STEP_S)
    x_ukf, P_ukf, ok = ukf.predict(par, noise, x, P, u, 8, SUB_STEP_S)
    assert ok.all()
    assert x_ukf == pytest.approx(x_ekf, rel=1e-10, abs=1e-10)
    assert P_ukf == pytest.approx(P_ekf, rel=1e-10, abs=1e-10)


def test_the_seam_of_the_angle_does_not_show():
    """Turning motor and frame by any angle turns the result and changes nothing else."""
    par, noise = bench(2)
    x = np.array([[3.0, 4.0, 150.0, 0.0, 5.0], [3.0, 4.0, 150.0, np.pi, 5.0]])
    x[1, :2] *= -1.0
    P = np.tile(np.diag([0.1, 0.1, 4.0, 0.3, 9.0]), (2, 1, 1))
    u = np.array([[10.0, 20.0], [-10.0, -20.0]])
    x, P, _ = ukf.predict(par, noise, x, P, u, 16, SUB_STEP_S)
    assert x[1, :2] == pytest.approx(-x[0, :2])
    assert motor_model.wrap(x[1, 3:4] - x[0, 3] - np.pi) == pytest.approx([0.0], abs=1e-12)
    assert x[1, [2, 4]] == pytest.approx(x[0, [2, 4]])
    assert np.diagonal(P[1]) == pytest.approx(np.diagonal(P[0]))


def test_broken_covariances_are_repaired_once_or_masked():
    good = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    rounding = good.copy()
    rounding[0, 1] = rounding[1, 0] = np.sqrt(2.0) * (1.0 + 1e-8)
    hopeless = good.copy()
    hopeless[2, 2] = -1.0
    nothing = np.full((5, 5), np.nan)
    L, ok = ukf.factor(np.stack([good, rounding, hopeless, nothing]))
    assert ok.tolist() == [True, True, False, False]
    assert L[0] == pytest.approx(np.linalg.cholesky(good))
    assert L[1] @ L[1].T == pytest.approx(rounding, rel=2e-6, abs=1e-6)


def test_a_broken_drive_is_masked_and_the_others_are_untouched():
    par, noise = bench(2)
    x, P = start(2, 5)
    P[0, 0, 0] = -1.0
    u = np.zeros((2, 2))
    _, _, ok = ukf.predict(par, noise, x, P, u, 4, SUB_STEP_S)
    assert ok.tolist() == [False, True]
