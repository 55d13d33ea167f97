"""Linear Kalman filter for stacks of N independent systems: paper `adhesion`, eq. (3)-(7).

Batch axis first. The measurement update is in Joseph form, which stays positive semi-definite
under rounding where eq. (7) does not; both are equal in exact arithmetic.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from jaxtyping import Float

Array = NDArray[np.float64]


class Innovation(NamedTuple):
    """What a measurement said beyond the prediction.

    nu: (N, m) y - H x; S: (N, m, m) its covariance; nis: (N,) nu' S^-1 nu, chi-square with m
    degrees of freedom when the model holds.
    """

    nu: Float[Array, "N m"]
    S: Float[Array, "N m m"]
    nis: Float[Array, "N"]


def transpose(M: Array) -> Array:
    """Matrix axes swapped, batch axis kept."""
    return np.swapaxes(M, -1, -2)


def symmetric(P: Array) -> Array:
    """The symmetric part of P."""
    return 0.5 * (P + transpose(P))


def update(
    x: Float[Array, "N n"],
    P: Float[Array, "N n n"],
    y: Float[Array, "N m"],
    H: Float[Array, "m n"],
    R: Float[Array, "N m m"],
) -> tuple[Float[Array, "N n"], Float[Array, "N n n"], Innovation]:
    """Posterior after measuring y = H x + noise of covariance R, eq. (5)-(7).

    Raises numpy.linalg.LinAlgError when S is exactly singular: R must be positive.
    """
    nu = y - x @ H.T
    HP = H @ P
    S = HP @ H.T + R
    K = transpose(np.linalg.solve(S, HP).astype(np.float64, copy=False))
    nis = np.einsum("ni,ni->n", nu, np.linalg.solve(S, nu[..., None])[..., 0])
    x = x + np.einsum("nij,nj->ni", K, nu)
    A = np.eye(x.shape[1]) - K @ H
    P = A @ P @ transpose(A) + K @ R @ transpose(K)
    return x, symmetric(P), Innovation(nu, S, nis)
