"""Unscented Kalman filter against filterpy."""

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
