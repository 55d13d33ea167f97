"""Unscented Kalman filter of N drives with `models.pmsm`, the alternative to `ekf`.

Symmetric sigma points in the kappa form (Julier and Uhlmann): with n = 5 states
    X_0 = x, X_j = x + c L e_j, X_(n+j) = x - c L e_j, P = L L', c = sqrt(n + kappa),
    W_0 = kappa / (n + kappa), W_j = 1 / (2 (n + kappa)).
kappa = 0 is the default: equal weights, no negative one, so P stays positive semi-definite.

The angle enters the model only through sine and cosine, so the points lie on the unrolled
line around the mean and only the mean is wrapped: no average is ever taken across +-pi.
Measuring is linear, for which the unscented transform is exact: the update is the EKF's. A gap
without samples is bridged as in the EKF.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimators.models.pmsm import THETA_E, W_E, Noise, Pmsm
from tests.reference import ekf, kalman, motor_model

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Array = NDArray[np.float64]

KAPPA = 0.0
REPAIR = 1e-6
"""Relative rise of the variances that repairs a covariance without a Cholesky factor."""


def predict(
    par: Pmsm,
    noise: Noise,
    x: Float[Array, "N 5"],
    P: Float[Array, "N 5 5"],
    u: Float[Array, "N 2"],
    n_sub: int,
    dt: float,
    kappa: float = KAPPA,
) -> tuple[Float[Array, "N 5"], Float[Array, "N 5 5"], Bool[NDArray[np.bool_], "N"]]:
    """Prior n_sub sub-steps of dt later; sigma points are drawn anew in each.

    Also gives ok (N,): False where P had no Cholesky factor, even repaired; the numbers of
    such a drive are NaN. Never raises on numbers.
    """
    n = x.shape[1]
    W = 0.5 / (n + kappa)
    W_0 = kappa / (n + kappa)
    Q = noise.Q[:, :, None] * np.eye(n)
    ok = np.ones(len(x), dtype=np.bool_)
    v = motor_model.turning(u, x[:, W_E], n_sub, dt)
    for k in range(n_sub):
        L, good = factor(P)
        ok &= good
        spread = np.sqrt(n + kappa) * L
        centre = motor_model.step(par, x, v[:, k], dt)
        # Deviations of the images from the image of the mean: well conditioned.
        images = [
            motor_model.step(par, x + spread[:, :, j], v[:, k], dt) - centre for j in range(n)
        ]
        images += [
            motor_model.step(par, x - spread[:, :, j], v[:, k], dt) - centre for j in range(n)
        ]
        D = np.stack(images, axis=1)
        shift = W * D.sum(axis=1)
        D = D - shift[:, None, :]
        x = centre + shift
        P = W * kalman.transpose(D) @ D + W_0 * shift[:, :, None] * shift[:, None, :] + Q
    x = x.copy()
    x[:, THETA_E] = motor_model.wrap(x[:, THETA_E])
    return x, kalman.symmetric(P), ok


def factor(P: Float[Array, "N n n"]) -> tuple[Array, NDArray[np.bool_]]:
    """Lower Cholesky factors (N, n, n) and ok (N,).

    A matrix that has none is tried once more with variances raised by REPAIR; if it still has
    none, ok is False there and the factor NaN.
    """
    L, ok = _cholesky(P)
    if ok.all():
        return L, ok
    k = np.arange(P.shape[1])
    repaired = P.copy()
    repaired[:, k, k] += REPAIR * np.abs(P[:, k, k]) + ekf.FLOOR
    L_repaired, ok_repaired = _cholesky(repaired)
    return np.where(ok[:, None, None], L, L_repaired), ok | ok_repaired


def _cholesky(P: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Stacked Cholesky that reports by mask: numpy's raises for the whole stack."""
    n = P.shape[1]
    L = np.zeros_like(P)
    ok = np.ones(len(P), dtype=np.bool_)
    for j in range(n):
        pivot = P[:, j, j] - np.sum(L[:, j, :j] ** 2, axis=1)
        ok &= pivot > 0.0
        L[:, j, j] = np.sqrt(np.where(pivot > 0.0, pivot, np.nan))
        for i in range(j + 1, n):
            dot = np.sum(L[:, i, :j] * L[:, j, :j], axis=1)
            L[:, i, j] = (P[:, i, j] - dot) / L[:, j, j]
    return L, ok
