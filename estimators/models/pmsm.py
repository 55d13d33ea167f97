"""Permanent-magnet synchronous motor in the stationary frame: paper `adhesion`, eq. (11)-(13).

State x = [i_alpha, i_beta, w_e, theta_e, T_L] (A, A, rad/s electrical, rad, Nm); the load
torque T_L is a random walk (paper, section 3.2.1). Input u = [u_alpha, u_beta] (V), output
y = [i_alpha, i_beta] (A). Batch axis first: N drives, each with its own motor.

The equations are in `filter_simd.c`; here are the motor's constants and the filters' noise.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dbc.arrays import Array

if TYPE_CHECKING:
    from jaxtyping import Float


I_A, I_B, W_E, THETA_E, T_L = range(5)
"""Columns of x."""
SUB_STEP_S = 125e-6
"""The paper's sampling period: the sub-step between samples of a slower bus."""
RATED_BENCH_I = 25.0
RATED_BENCH_T = 30.0
THETA_VAR = 1e-6
"""Process variance of the angle per 125 us, rad^2.

It sets the effect of wrong motor constants: if the angle may move a little, the filter need not
turn a wrong back-EMF into speed and load. Load error at 200 rad/s with psi_f 20 % low: 43 Nm
with 1e-8, 6 Nm with 1e-6; with R_s off by 20 %: 3.6 and 0.9 Nm; with the right constants both give
the same. The price: with 1e-8 the filter finds the rotor from every start angle; from 3e-7 on,
half of all starts end 2.5 to 3 rad off for good. `acquisition.c` gives the start angle and
checks it later; without it, use 1e-8.
"""


class Pmsm(NamedTuple):
    """Motor constants, each (N,).

    R_s ohm, L_s H (L_d = L_q), psi_f Wb, p pole pairs, J kg m2 at the motor shaft, B Nm s/rad,
    k_p Park constant (1.5 for amplitude-invariant alpha-beta).
    """

    R_s: Float[Array, "N"]
    L_s: Float[Array, "N"]
    psi_f: Float[Array, "N"]
    p: Float[Array, "N"]
    J: Float[Array, "N"]
    B: Float[Array, "N"]
    k_p: Float[Array, "N"]


class Rated(NamedTuple):
    """Rated phase current amplitude I (A) and shaft torque T (Nm), each (N,)."""

    I: Float[Array, "N"]  # noqa: E741 - the paper's symbol for current
    T: Float[Array, "N"]


class Noise(NamedTuple):
    """Disturbance and sensor noise that the filters assume.

    Q: (N, 5) variance added per sub-step; R: (N, 2) variance of y, A^2; coast: (N,) variance of
    the phase currents in and after a stretch without samples, A^2.
    """

    Q: Float[Array, "N 5"]
    R: Float[Array, "N 2"]
    coast: Float[Array, "N"]


def motors(*constants: tuple[float, float, float, float, float, float, float]) -> Pmsm:
    """One row (R_s, L_s, psi_f, p, J, B, k_p) per drive. ValueError if they are not physical."""
    rows = np.asarray(constants, dtype=np.float64).reshape(-1, 7)
    if not np.isfinite(rows).all() or (rows[:, [0, 5]] < 0.0).any():
        raise ValueError("motor constants must be finite, R_s and B not negative")
    if (rows[:, [1, 2, 3, 4, 6]] <= 0.0).any():
        raise ValueError("L_s, psi_f, p, J and k_p must be positive")
    return Pmsm(*np.ascontiguousarray(rows.T))


def table(par: Pmsm) -> Float[Array, "N 7"]:
    """The constants as one row per drive, in the order of `Pmsm`: what the kernels take."""
    return np.ascontiguousarray(np.stack(par, axis=1))


def repeat(par: Pmsm, n: int) -> Pmsm:
    """`n` drives with the motor(s) of `par`, one after the other."""
    return Pmsm(*(np.tile(value, n) for value in par))


BENCH_MOTOR = motors((0.28, 3.465e-3, 0.1989, 4.0, 0.04, 0.0, 1.5))
"""The motor of paper `adhesion`, (1,). The paper does not print the constants; these give its
theta_a .98990, theta_b .007175, theta_c .03608, theta_e .01492 at 125 us."""
BENCH_RATED = Rated(np.array([RATED_BENCH_I]), np.array([RATED_BENCH_T]))
"""Rated values of the bench motor, our choice: 30 Nm needs 25 A."""


def default_noise(
    par: Pmsm,
    rated: Rated,
    dt: float = SUB_STEP_S,
    i_lsb: float = 0.02,
    sensor_var: float = 2e-4,
    theta_var: float = THETA_VAR,
) -> Noise:
    """Noise per unit of the motor's rated values, for sub-steps of dt seconds.

    On the bench motor Q = diag(1e-4, 1e-4, 1e-5, 1e-6, 0.1) per 125 us, where the paper has
    diag(0.05, 0.05, 1e-3, 1e-4, 0.1): see THETA_VAR. Other motors: currents scale with I^2,
    load with T^2, speed with the square of the acceleration p T / J, the angle not at all.
    R = sensor variance (A^2 on the bench motor, scales with I^2) + i_lsb^2 / 12 of the wire.
    """
    i_pu = (rated.I / RATED_BENCH_I) ** 2
    t_pu = (rated.T / RATED_BENCH_T) ** 2
    bench_rate = BENCH_MOTOR.p[0] * RATED_BENCH_T / BENCH_MOTOR.J[0]
    w_pu = (par.p * rated.T / par.J / bench_rate) ** 2
    per_step = dt / SUB_STEP_S
    one = np.ones_like(i_pu)
    Q = per_step * np.stack(
        [1e-4 * i_pu, 1e-4 * i_pu, 1e-5 * w_pu, theta_var * one, 0.1 * t_pu], axis=1
    )
    R = np.repeat((sensor_var * i_pu + i_lsb**2 / 12.0)[:, None], 2, axis=1)
    # 5 A of 25 A: what a current controller changes within a few missing samples.
    return Noise(Q, R, (0.2 * rated.I) ** 2)
