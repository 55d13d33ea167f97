"""Linear filter against an implementation nobody here wrote."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from tests.reference import kalman


def test_equals_filterpy_over_many_steps():
    rng = np.random.default_rng(4)
    n, m, batch = 4, 2, 3
    F = np.eye(n) + 0.1 * rng.normal(size=(batch, n, n))
    H = rng.normal(size=(m, n))
    Q = np.stack([np.diag(rng.uniform(0.01, 0.1, n)) for _ in range(batch)])
    R = np.stack([np.diag(rng.uniform(0.1, 1.0, m)) for _ in range(batch)])
    x, P = rng.normal(size=(batch, n)), np.tile(np.eye(n), (batch, 1, 1))
    others = []
    for k in range(batch):
        other = KalmanFilter(n, m)
        other.x, other.P, other.F = x[k].copy(), P[k].copy(), F[k]
        other.H, other.Q, other.R = H, Q[k], R[k]
        others.append(other)
    for _ in range(100):
        y = rng.normal(size=(batch, m))
        x, P = kalman.predict(x, P, F, Q)
        x, P, innovation = kalman.update(x, P, y, H, R)
        for k, other in enumerate(others):
            other.predict()
            other.update(y[k])
            assert x[k] == pytest.approx(other.x, rel=1e-9, abs=1e-9)
            assert P[k] == pytest.approx(other.P, rel=1e-9, abs=1e-9)
            assert innovation.S[k] == pytest.approx(other.S, rel=1e-9)
            assert innovation.nis[k] == pytest.approx(other.mahalanobis**2, rel=1e-9)


def test_joseph_form_equals_eq_7_and_survives_where_it_does_not():
    H, R = np.eye(1, 2), np.full((1, 1, 1), 1e-14)
    P = np.array([[[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]]])
    _, joseph, innovation = kalman.update(np.zeros((1, 2)), P, np.ones((1, 1)), H, R)
    assert np.linalg.eigvalsh(joseph[0]).min() >= 0.0
    K = P[0] @ H.T / innovation.S[0]
    assert joseph[0] == pytest.approx((np.eye(2) - K @ H) @ P[0], abs=1e-12)
