"""Extended and unscented Kalman filter: filterpy, and what they do in the odd case."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter

from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S
from tests.reference import ekf, motor_model, ukf


def bench(n):
    par = pmsm.repeat(pmsm.BENCH_MOTOR, n)
    rated = pmsm.Rated(np.full(n, 25.0), np.full(n, 30.0))
    return par, pmsm.default_noise(par, rated)


def start(n, seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (n, 5)) * [20.0, 20.0, 200.0, 3.0, 20.0]
    A = rng.normal(size=(n, 5, 5)) * np.array([0.3, 0.3, 3.0, 0.1, 3.0])[:, None]
    return x, A @ np.swapaxes(A, 1, 2) + 1e-3 * np.eye(5)


def test_equals_filterpy_over_many_steps():
    par, noise = bench(1)
    x, P = start(1, 3)

    class Motor(ExtendedKalmanFilter):
        def predict_x(self, u=0):
            self.x = motor_model.step(par, self.x[None], u[None], SUB_STEP_S)[0]

    other = Motor(5, 2)
    other.x, other.P = x[0].copy(), P[0].copy()
    other.Q, other.R = np.diag(noise.Q[0]), np.diag(noise.R[0])
    rng = np.random.default_rng(5)
    for _ in range(300):
        u, y = rng.normal(size=2) * 20.0, x[0, :2] + rng.normal(size=2)
        x, P = ekf.predict(par, noise, x, P, u[None], 3, SUB_STEP_S)
        x, P, _ = ekf.update(noise, x, P, y[None])
        v = motor_model.turning(u[None], other.x[None, 2], 3, SUB_STEP_S)[0]
        for j in range(3):
            other.F = motor_model.jacobian(par, other.x[None], SUB_STEP_S)[0]
            other.predict(v[j])
        other.update(y, lambda _: np.eye(2, 5), lambda z: z[:2])
        assert motor_model.wrap(x[:, 3] - other.x[3]) == pytest.approx([0.0], abs=1e-9)
        assert np.delete(x[0], 3) == pytest.approx(np.delete(other.x, 3), rel=1e-9, abs=1e-9)
        assert P[0] == pytest.approx(other.P, rel=1e-9, abs=1e-9)


def test_coasting_admits_ignorance_of_torque():
    """5 A unknown over 10 ms: k_p p^2 psi_f / J * 5 A * 10 ms = 5.97 rad/s at least."""
    par, noise = bench(1)
    x, P = start(1, 8)
    _, P_after = ekf.coast(par, noise, x, P, 80, SUB_STEP_S)
    assert P_after[0, 0, 0] + P_after[0, 1, 1] >= 50.0
    assert np.sqrt(P_after[0, 2, 2]) >= 1.5 * 16.0 * 0.1989 / 0.04 * 5.0 * 0.01


@pytest.mark.parametrize("missing", [16, 64])
def test_the_first_sample_after_a_gap_sets_the_currents_and_nothing_else(missing):
    """A controller changed them meanwhile: 5 A are no torque that acted all along, and no load."""
    par, noise = bench(1)
    x = np.array([[1.0, 10.0, 100.0, 0.3, 12.0]])
    P = np.diag([2e-4, 2e-4, 0.2, 1e-4, 3.0])[None]
    x, P = ekf.coast(par, noise, x, P, missing, SUB_STEP_S)
    x, P = ekf.predict(par, noise, x, P, np.array([[5.0, -5.0]]), 16, SUB_STEP_S)
    y = x[:, :2] + [[3.0, -4.0]]
    after, P_after, innovation = ekf.update(noise, x, P, y)
    assert after[0, :2] == pytest.approx(y[0], abs=0.01)
    assert innovation.nis[0] < 2.0
    assert after[0, 4] == pytest.approx(x[0, 4], abs=0.5)
    assert after[0, 2] == pytest.approx(x[0, 2], abs=1.5)
    assert P_after[0, 4, 4] > 3.0


@pytest.mark.parametrize("w", [100.0, -880.0])
def test_the_covariance_follows_the_derivative_of_the_whole_prediction(w):
    """Sixteen sub-steps. That the voltage turns with w is left out of F: it changes the currents
    by less than a twentieth of what the back-EMF does.
    """
    par, noise = bench(1)
    noise = noise._replace(Q=np.zeros((1, 5)))
    x = np.array([[3.0, 12.0, w, 0.4, 9.0]])
    u = np.array([[20.0, 0.19 * w]])

    def ahead(z):
        return ekf.predict(par, noise, z, np.zeros((1, 5, 5)), u, 16, SUB_STEP_S)[0][0]

    for j, h in enumerate([1e-3, 1e-3, 1e-2, 1e-5, 1e-3]):
        e = h * np.eye(5)[j]
        P = np.zeros((1, 5, 5))
        P[0, j, j] = 1.0
        column = (ahead(x + e) - ahead(x - e)) / (2.0 * h)
        got = ekf.predict(par, noise, x, P, u, 16, SUB_STEP_S)[1][0]
        tolerance = 0.05 * np.abs(column).max() if j == 2 else 1e-5 * max(np.abs(column).max(), 1.0)
        signs = np.where(column < 0.0, -1.0, 1.0)
        assert signs * np.sqrt(np.diag(got)) == pytest.approx(column, abs=tolerance)


@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_ukf_equals_filterpy_over_many_steps(kappa):
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
