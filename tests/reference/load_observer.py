"""The load observer in Python, which `estimators/load_observer.c` is compared with.

For drives whose currents come too slowly for the flux-based filters, and for standstill. A
linear Kalman filter with the states speed and load,

    w+   = w + dt / J (T - B w - T_L) + q_w        T: mean of the torques at both ends
    T_L+ = T_L + q_L
    z    = w + r

so that the differentiation is as sharp as the speed's noise allows. Not in paper `adhesion`.
"""

from __future__ import annotations

from typing import NamedTuple


class Mechanics(NamedTuple):
    """J kg m2, B Nm s, and the noise: speed_var (rad/s)^2 of a reading, load_rate Nm^2 / s."""

    J: float
    B: float
    speed_var: float
    load_rate: float


class LoadState(NamedTuple):
    """w rad/s (rotor), T_L Nm, their covariance, last torque Nm, normalised innovation squared."""

    w: float
    T_L: float
    P_ww: float
    P_wL: float
    P_LL: float
    torque: float
    nis: float
    spread: float

    @property
    def sigma(self) -> float:
        """Of the load, Nm: by innovations, and 1 % of the load that none shows."""
        return float((self.spread * self.P_LL + (0.01 * self.T_L) ** 2) ** 0.5)


def first(w: float, torque: float, mechanics: Mechanics) -> LoadState:
    """A train is heavy: until its acceleration is known the load is the torque, give or take."""
    sigma = 0.5 * abs(torque) + (mechanics.load_rate * 0.1) ** 0.5
    return LoadState(w, torque, mechanics.speed_var, 0.0, sigma * sigma, torque, 1.0, 1.0)


def observe(state: LoadState, w: float, torque: float, dt: float, m: Mechanics) -> LoadState:
    """One reading, `dt` s (> 0) after the last. Finite numbers in, finite numbers out."""
    a, b = 1.0 - m.B * dt / m.J, -dt / m.J
    drive = 0.5 * (state.torque + torque)
    w_p = a * state.w + b * (state.T_L - drive)
    # A load that walks also moves the speed within the step: a third of the white-noise integral.
    q = m.load_rate * dt
    P_ww = a * a * state.P_ww + 2.0 * a * b * state.P_wL + b * b * (state.P_LL + q / 3.0)
    P_wL = a * state.P_wL + b * (state.P_LL + 0.5 * q)
    P_LL = state.P_LL + q
    S = P_ww + m.speed_var
    nu = w - w_p
    k_w, k_L = P_ww / S, P_wL / S
    return LoadState(
        w_p + k_w * nu,
        state.T_L + k_L * nu,
        (1.0 - k_w) * P_ww,
        (1.0 - k_w) * P_wL,
        P_LL - k_L * P_wL,
        torque,
        nu * nu / S,
        state.spread + 0.05 * (min(nu * nu / S, 8.0) - state.spread),
    )
