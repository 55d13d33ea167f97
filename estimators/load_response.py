"""Step response and noise of a load estimate: the filters at a steady speed.

In rotor coordinates, at a steady speed with i_d = 0, the filter of paper `adhesion`, eq. (11)-(13),
is linear and time-invariant, and so is the load observer (`load_observer.c`). The steady gain
follows from the process noise and the assumed measurement noise (Riccati). The error of the load
and the response to a step of the load follow from the gain and the true noise (Lyapunov).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array

SETTLED: Final = 1e-9
"""Relative change of a covariance below which it is steady."""
MOST_STEPS: Final = 4000


class Steady(NamedTuple):
    """A filter between two measurements. Its last state is the load, Nm.

    speed (n,): row that maps the state to the rotor's speed, rad/s. F (n, n) and Q (n, n): model
    and process noise of a sub-step, of which `steps` lie between two measurements. H (m, n):
    measurement matrix. R (m, m): measurement noise as the filter assumes it; V (m, m): the true
    one; W (n, n): true noise that a known input adds between two measurements. adapts: R is scaled
    up until the innovations fit (`adaptation.c`).
    """

    speed: Array
    F: Array
    Q: Array
    steps: int
    H: Array
    R: Array
    V: Array
    W: Array
    adapts: bool


class Answer(NamedTuple):
    """Response of a `Steady`: A (n, n) maps the error after a measurement to that after the next.

    noise (n, n): variance that a measurement adds to the error; P (n, n): steady variance of the
    error. within (steps, n): error after the next measurement if the load steps by 1 Nm before the
    k-th sub-step of an interval. rest (n, n): maps the error before a measurement to that after it.
    out (2, n): rows that map an error to the errors of load, Nm, and speed, rad/s.
    """

    A: Array
    noise: Array
    P: Array
    within: Array
    rest: Array
    out: Array

    @property
    def sigma(self) -> float:
        """Standard deviation of the load, Nm."""
        return float(np.sqrt(self.P[-1, -1]))


def ekf(
    motor: Array, Q: Array, R: Array, V: Array, u_var: float, w_e: float, steps: int,
    dt: float,
) -> Steady:  # fmt: skip
    """The EKF at w_e rad/s. motor: a row of `pmsm.table`; Q (5,), R (2,) as in `Noise`.

    V (2, 2): true noise, A^2; u_var: variance of the voltage's quantisation, V^2; steps: sub-steps
    of dt s per sample.
    """
    R_s, L_s, psi_f, p, J, B, k_p = motor
    turn = np.eye(5)
    c, s = np.cos(w_e * dt), np.sin(w_e * dt)
    turn[:2, :2] = [[c, s], [-s, c]]
    F = np.eye(5)
    F[0, 0] = F[1, 1] = 1.0 - R_s / L_s * dt
    F[0, 3], F[1, 2] = psi_f / L_s * dt * w_e, -psi_f / L_s * dt
    F[2, 1] = k_p * p * p * psi_f / J * dt
    F[2, 2], F[2, 4] = 1.0 - B / J * dt, -p / J * dt
    F[3, 2] = dt
    W = np.zeros((5, 5))
    W[0, 0] = W[1, 1] = u_var * (steps * dt / L_s) ** 2
    speed = np.array([0.0, 0.0, 1.0 / p, 0.0, 0.0])
    return Steady(speed, turn @ F, np.diag(Q), steps, np.eye(2, 5), np.diag(R), V, W, adapts=True)


def observer(
    J: float, B: float, load_rate: float, speed_var: tuple[float, float], torque_var: float,
    period_s: float, steps: int,
) -> Steady:  # fmt: skip
    """The load observer. speed_var: variance of the speed, assumed and true, (rad/s)^2.

    load_rate: Nm^2/s, as in `struct mechanics`; torque_var: of the measured torque, Nm^2.
    """
    dt = period_s / steps
    F = np.array([[1.0 - B / J * dt, -dt / J], [0.0, 1.0]])
    assumed, true = speed_var
    W = np.diag([torque_var * (period_s / J) ** 2 / 2.0, 0.0])
    Q = np.diag([0.0, load_rate * dt])
    return Steady(
        np.eye(1, 2)[0],
        F,
        Q,
        steps,
        np.eye(1, 2),
        np.array([[assumed]]),
        np.array([[true]]),
        W,
        adapts=False,
    )


def answer(of: Steady) -> Answer:
    """Response and noise of a filter. Raises ValueError if the load cannot be observed."""
    powers = [np.eye(len(of.F))]
    for _ in range(of.steps):
        powers.append(of.F @ powers[-1])
    F, Q = powers[-1], np.sum([f @ of.Q @ f.T for f in powers[:-1]], axis=0)
    P, scale = np.diag(10.0 * Q.diagonal() + SETTLED), 1.0
    while True:
        P, K = _steady(F, Q, P, of.H, scale * of.R)
        rest = np.eye(len(F)) - K @ of.H
        A = rest @ F
        if not (np.isfinite(A).all() and np.abs(np.linalg.eigvals(A)).max() < 1.0):
            raise ValueError("the load cannot be observed at this speed")
        noise = rest @ of.W @ rest.T + K @ of.V @ K.T
        true = _sum(A, noise)
        before = F @ true @ F.T + of.W
        nis = np.trace(
            np.linalg.solve(of.H @ P @ of.H.T + scale * of.R, of.H @ before @ of.H.T + of.V)
        )
        wider = max(1.0, scale * nis / len(of.H)) if of.adapts else 1.0
        if abs(wider / scale - 1.0) < 0.01:
            break
        scale = wider
    within = np.array([rest @ powers[of.steps - k][:, -1] for k in range(of.steps)])
    return Answer(A, noise, true, within, rest, np.stack([np.eye(len(F))[-1], of.speed]))


def _steady(F: Array, Q: Array, P: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """Covariance before a measurement, and the gain."""
    for _ in range(MOST_STEPS):
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        after = F @ (P - K @ H @ P) @ F.T + Q
        after = 0.5 * (after + after.T)
        steady = np.abs(after - P).max() <= SETTLED * np.abs(after).max()
        P = after
        if steady:
            break
    return P, K


def _sum(A: Array, noise: Array) -> Array:
    """Limit of noise + A noise A' + .., by doubling."""
    P, step = noise, A
    for _ in range(60):
        P, step = P + step @ P @ step.T, step @ step
    return P
