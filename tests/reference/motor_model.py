"""The motor's equations in NumPy: paper `adhesion`, eq. (11)-(13), for the filters' oracles.

State x, input u and output y as in `estimators.models.pmsm`. Batch axis first: N drives.

Corrections to the paper: eq. (11) has T_L in the speed equation but its Jacobian (below (13))
has neither row nor column for it, and the two printed forms of row 3 differ. `jacobian` is the
derivative of `step`, all 25 entries.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dbc.arrays import Array
from estimators.models.pmsm import I_A, I_B, T_L, THETA_E, W_E, Pmsm

if TYPE_CHECKING:
    from jaxtyping import Float

TURN_MAX = 1.4
"""Half the turn of the voltage over an interval, rad, up to which it is taken to turn."""


def wrap(theta: Array) -> Array:
    """Angle in (-pi, pi]."""
    return theta - 2.0 * math.pi * np.ceil((theta - math.pi) / (2.0 * math.pi))


def _thetas(par: Pmsm, dt: float) -> tuple[Array, Array, Array, Array]:
    """theta_a, theta_b, theta_d, theta_e of eq. (12)-(13)."""
    theta_a = 1.0 - par.R_s / par.L_s * dt
    theta_b = par.psi_f / par.L_s * dt
    theta_d = 1.0 - par.B / par.J * dt
    theta_e = par.k_p * par.p**2 * par.psi_f / par.J * dt
    return theta_a, theta_b, theta_d, theta_e


def step(
    par: Pmsm, x: Float[Array, "N 5"], u: Float[Array, "N 2"], dt: float
) -> Float[Array, "N 5"]:
    """One Euler step of eq. (11) with T_L constant. The angle is not wrapped."""
    theta_a, theta_b, theta_d, theta_e = _thetas(par, dt)
    i_a, i_b, w_e, theta, load = x.T
    sin, cos = np.sin(theta), np.cos(theta)
    return np.stack(
        [
            theta_a * i_a + theta_b * w_e * sin + dt / par.L_s * u[:, 0],
            theta_a * i_b - theta_b * w_e * cos + dt / par.L_s * u[:, 1],
            theta_d * w_e + theta_e * (i_b * cos - i_a * sin) - par.p * dt / par.J * load,
            theta + w_e * dt,
            load,
        ],
        axis=1,
    )


def turning(
    u: Float[Array, "N 2"], w_e: Float[Array, "N"], n_sub: int, dt: float
) -> Float[Array, "N n_sub 2"]:
    """Voltage of each of n_sub sub-steps whose mean is the measured u, V.

    An inverter turns the voltage with the rotor; held still between samples it would push the
    currents off course, and the load reads low by the square of w. With h = w dt / 2, sub-step j
        u n sin(h) / sin(n h) exp(i 2 h (j - (n - 1) / 2))
    keeps the volt-seconds. Held as it is where the interval is more than TURN_MAX / pi turns.
    """
    h = 0.5 * dt * w_e
    turns = np.abs(n_sub * h) <= TURN_MAX
    h = np.where(turns & (h != 0.0), h, 1e-12)
    gain = n_sub * np.sin(h) / np.sin(n_sub * h)
    angle = 2.0 * h[:, None] * (np.arange(n_sub) - 0.5 * (n_sub - 1))
    z = ((u[:, 0] + 1j * u[:, 1]) * gain)[:, None] * np.exp(1j * angle)
    return np.stack([z.real, z.imag], axis=2)


def jacobian(par: Pmsm, x: Float[Array, "N 5"], dt: float) -> Float[Array, "N 5 5"]:
    """Derivative of `step` by x; corrects the matrices below eq. (13), see the module text."""
    theta_a, theta_b, theta_d, theta_e = _thetas(par, dt)
    i_a, i_b, w_e, theta, _ = x.T
    sin, cos = np.sin(theta), np.cos(theta)
    F = np.zeros((len(x), 5, 5))
    F[:, 0, 0] = theta_a
    F[:, 0, 2] = theta_b * sin
    F[:, 0, 3] = theta_b * w_e * cos
    F[:, 1, 1] = theta_a
    F[:, 1, 2] = -theta_b * cos
    F[:, 1, 3] = theta_b * w_e * sin
    F[:, 2, 0] = -theta_e * sin
    F[:, 2, 1] = theta_e * cos
    F[:, 2, 2] = theta_d
    F[:, 2, 3] = -theta_e * (i_b * sin + i_a * cos)
    F[:, 2, 4] = -par.p * dt / par.J
    F[:, 3, 2] = dt
    F[:, 3, 3] = 1.0
    F[:, 4, 4] = 1.0
    return F


def torque(par: Pmsm, x: Float[Array, "N 5"]) -> Float[Array, "N"]:
    """Air-gap torque k_p p psi_f i_q, Nm: J/p times the current term of eq. (11)."""
    i_q = x[:, I_B] * np.cos(x[:, THETA_E]) - x[:, I_A] * np.sin(x[:, THETA_E])
    return par.k_p * par.p * par.psi_f * i_q


def coast(par: Pmsm, x: Float[Array, "N 5"], tau: Float[Array, "N"]) -> Float[Array, "N 5"]:
    """Advance by tau seconds (N,) for which the voltage is unknown.

    The rotor-frame currents stay, so the torque does; acceleration is constant:
    w += a tau, theta += w tau + a tau^2/2 =: turn, currents turn with the rotor,
    a = p/J (T_e - T_L) - B/J w. Meant for gaps below a second. The angle is not wrapped.
    """
    a = par.p / par.J * (torque(par, x) - x[:, T_L]) - par.B / par.J * x[:, W_E]
    turn = tau * x[:, W_E] + 0.5 * tau**2 * a
    sin, cos = np.sin(turn), np.cos(turn)
    return np.stack(
        [
            cos * x[:, I_A] - sin * x[:, I_B],
            sin * x[:, I_A] + cos * x[:, I_B],
            x[:, W_E] + tau * a,
            x[:, THETA_E] + turn,
            x[:, T_L],
        ],
        axis=1,
    )


def coast_jacobian(
    par: Pmsm, x: Float[Array, "N 5"], tau: Float[Array, "N"]
) -> Float[Array, "N 5 5"]:
    """Derivative of `coast` by x."""
    i_a, i_b, w_e, theta, load = x.T
    sin, cos = np.sin(theta), np.cos(theta)
    kappa = par.k_p * par.p**2 * par.psi_f / par.J
    a = kappa * (i_b * cos - i_a * sin) - par.p / par.J * load - par.B / par.J * w_e
    da = np.stack(
        [
            -kappa * sin,
            kappa * cos,
            -par.B / par.J,
            -kappa * (i_b * sin + i_a * cos),
            -par.p / par.J,
        ],
        axis=1,
    )
    unit = np.eye(5)
    d_turn = 0.5 * tau[:, None] ** 2 * da + tau[:, None] * unit[W_E]
    turn = tau * w_e + 0.5 * tau**2 * a
    sin, cos = np.sin(turn), np.cos(turn)
    F = np.zeros((len(x), 5, 5))
    F[:, 0] = (-sin * i_a - cos * i_b)[:, None] * d_turn
    F[:, 1] = (cos * i_a - sin * i_b)[:, None] * d_turn
    F[:, 0, 0] += cos
    F[:, 0, 1] -= sin
    F[:, 1, 0] += sin
    F[:, 1, 1] += cos
    F[:, 2] = unit[W_E] + tau[:, None] * da
    F[:, 3] = unit[THETA_E] + d_turn
    F[:, 4] = unit[T_L]
    return F
