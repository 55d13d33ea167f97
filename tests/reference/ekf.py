"""Extended Kalman filter of N drives: paper `adhesion`, eq. (3)-(15), with `models.pmsm`.

Stacked arrays in NumPy: what `estimators/filter_simd.c` is compared with. Drives are
independent, so the paper's block-diagonal matrices (16)-(17) are never built.

Between two samples the model takes n_sub Euler steps of dt with the mean voltage of the
interval: the paper filters at 125 us, buses are slower.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimators.models.pmsm import I_A, I_B, THETA_E, W_E, Noise, Pmsm
from tests.reference import kalman, motor_model
from tests.reference.kalman import Innovation

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

Array = NDArray[np.float64]

H = np.eye(2, 5)
"""The currents are measured: eq. (15) with a column for T_L."""
FLOOR = 1e-12
"""Smallest variance, SI units squared: no state is ever taken for exactly known."""


def predict(
    par: Pmsm,
    noise: Noise,
    x: Float[Array, "N 5"],
    P: Float[Array, "N 5 5"],
    u: Float[Array, "N 2"],
    n_sub: int,
    dt: float,
) -> tuple[Float[Array, "N 5"], Float[Array, "N 5 5"]]:
    """Prior n_sub sub-steps of dt later, eq. (3)-(4) with (8) per sub-step, angle wrapped."""
    Q = _diagonal(noise.Q)
    v = motor_model.turning(u, x[:, W_E], n_sub, dt)
    for j in range(n_sub):
        F = motor_model.jacobian(par, x, dt)
        x = motor_model.step(par, x, v[:, j], dt)
        P = F @ P @ kalman.transpose(F) + Q
    return _wrapped(x), kalman.symmetric(P)


def coast(
    par: Pmsm, noise: Noise, x: Float[Array, "N 5"], P: Float[Array, "N 5 5"], n_gap: int, dt: float
) -> tuple[Float[Array, "N 5"], Float[Array, "N 5 5"]]:
    """Prior after n_gap sub-steps without voltage: `motor_model.coast` in one step.

    What the voltage did meanwhile is unknown. A torque off by that of noise.coast all along is
    added to speed and angle. The currents at the end are off by noise.coast too, but for
    themselves: the next sample sets them anew instead of moving speed and load.
    """
    if n_gap == 0:
        return x, P
    tau = np.full(len(x), n_gap * dt)
    F = motor_model.coast_jacobian(par, x, tau)
    P = F @ P @ kalman.transpose(F) + n_gap * _diagonal(noise.Q)
    kappa = par.k_p * par.p**2 * par.psi_f / par.J
    g = np.zeros_like(x)
    g[:, W_E] = kappa * tau
    g[:, THETA_E] = 0.5 * kappa * tau**2
    P = P + noise.coast[:, None, None] * g[:, :, None] * g[:, None, :]
    P[:, I_A, I_A] += noise.coast
    P[:, I_B, I_B] += noise.coast
    return _wrapped(motor_model.coast(par, x, tau)), kalman.symmetric(P)


def update(
    noise: Noise, x: Float[Array, "N 5"], P: Float[Array, "N 5 5"], y: Float[Array, "N 2"]
) -> tuple[Float[Array, "N 5"], Float[Array, "N 5 5"], Innovation]:
    """Posterior after measuring the currents, eq. (5)-(7): exact, for h is linear."""
    x, P, innovation = kalman.update(x, P, y, H, _diagonal(noise.R))
    k = np.arange(5)
    variance = P[:, k, k]
    # A negative variance must stay visible to `healthy`; the floor is for rounding to zero.
    P[:, k, k] = np.where((variance >= 0.0) & (variance < FLOOR), FLOOR, variance)
    return _wrapped(x), P, innovation


def leaned(
    u: Float[Array, "N 2"], lean: Float[Array, "N"], half: float, x: Float[Array, "N 5"]
) -> Float[Array, "N 2"]:
    """Voltages less `lean` volts along the q axis, where it stands `half` seconds from now.

    What the data sheet does not know of: R_s and psi_f that are off act along q while i_d is 0.
    """
    angle = x[:, THETA_E] + half * x[:, W_E]
    along_q = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    v: Array = u - lean[:, None] * along_q
    return v


def healthy(x: Float[Array, "N 5"], P: Float[Array, "N 5 5"]) -> Bool[NDArray[np.bool_], "N"]:
    """True where the state is finite and no variance is negative."""
    finite = np.isfinite(x).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
    k = np.arange(5)
    positive = (P[:, k, k] >= 0.0).all(axis=1)
    return np.asarray(finite & positive, dtype=np.bool_)


def sweep(
    par: Pmsm,
    noise: Noise,
    x: Float[Array, "N 5"],
    P: Float[Array, "N 5 5"],
    drive: Int[NDArray[np.int32], "M"],
    u: Float[Array, "M 2"],
    y: Float[Array, "M 2"],
    n_sub: Int[NDArray[np.int64], "M"],
    n_gap: Int[NDArray[np.int64], "M"],
    dt: float,
    lean: Float[Array, "N"] | None = None,
    prior: Callable[..., tuple[Array, Array, NDArray[np.bool_]]] | None = None,
) -> tuple[Float[Array, "M"], Bool[NDArray[np.bool_], "N"]]:
    """M samples in order, x and P in place: as `filter_run` does.

    lean: see `leaned`, none without; prior: `ukf.predict` in place of `predict`. Returns (nis
    (M,), ok (N,)). A drive whose result is not `healthy` gets ok False and nis NaN, keeps its last
    good x and P, and its later rows are skipped: start it anew.
    """
    lean = np.zeros(len(x)) if lean is None else lean
    nis = np.full(len(drive), np.nan)
    ok = np.ones(len(x), dtype=np.bool_)
    for k, d in enumerate(drive):
        if not ok[d]:
            continue
        one = slice(d, d + 1)
        par_d = Pmsm(*(value[one] for value in par))
        noise_d = Noise(*(value[one] for value in noise))
        with np.errstate(all="ignore"):
            x_d, P_d = coast(par_d, noise_d, x[one], P[one], int(n_gap[k]), dt)
            v = leaned(u[k : k + 1], lean[one], 0.5 * int(n_sub[k]) * dt, x_d)
            given = par_d, noise_d, x_d, P_d, v, int(n_sub[k]), dt
            x_d, P_d, factored = prior(*given) if prior else (*predict(*given), ok[one])
            x_d, P_d, innovation = update(noise_d, x_d, P_d, y[k : k + 1])
        ok[d] = factored[0] and healthy(x_d, P_d)[0]
        if ok[d]:
            x[one], P[one] = x_d, P_d
            nis[k] = innovation.nis[0]
    return nis, ok


def _diagonal(variance: Array) -> Array:
    """(N, k) variances as (N, k, k) covariances."""
    return variance[:, :, None] * np.eye(variance.shape[1])


def _wrapped(x: Array) -> Array:
    x = x.copy()
    x[:, THETA_E] = motor_model.wrap(x[:, THETA_E])
    return x
