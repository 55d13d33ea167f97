"""Compiled parts of the filters, one drive at a time: what `_lanes_kernels` leaves over.

The loops over many samples of several drives are there. Twins in plain form: `ekf`, `ukf`. Row
layout: M samples in order of time, any mix of drives; drive (M,) int32, u (M, 2) V mean over the
sample's own interval, y (M, 2) A at its end, n_sub (M,) int64 sub-steps of dt in that interval,
n_gap (M,) int64 sub-steps missing before it.

The Jacobian has 14 entries other than 0 and 1 and the covariance 15 different ones: the EKF
writes both out, which is what makes a sub-step cheap, and this file long. P is taken from its
upper triangle.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import lean

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32]
Flags = NDArray[np.bool_]

_TWO_PI = 2.0 * math.pi
_FLOOR = 1e-12  # ekf.FLOOR
_REPAIR = 1e-6  # ukf.REPAIR
_TURN_MAX = 1.4  # pmsm.TURN_MAX


@lean
def wrap(theta: float) -> float:
    return theta - _TWO_PI * float(np.ceil((theta - math.pi) / _TWO_PI))


@lean
def _coast(
    par: Array, Q: Array, var: float, tau: float, n_gap: int, x: Array, P: Array, F: Array,
    M: Array,
) -> None:  # fmt: skip
    """`ekf.coast` on work arrays; F and M (5, 5) are scratch."""
    psi_f, p, J, B, k_p = par[2], par[3], par[4], par[5], par[6]
    kappa = k_p * p * p * psi_f / J
    sin, cos = math.sin(x[3]), math.cos(x[3])
    a = kappa * (x[1] * cos - x[0] * sin) - p / J * x[4] - B / J * x[2]
    turn = tau * x[2] + 0.5 * tau * tau * a
    sin_t, cos_t = math.sin(turn), math.cos(turn)
    i_a = cos_t * x[0] - sin_t * x[1]
    i_b = sin_t * x[0] + cos_t * x[1]
    da = (
        -kappa * sin,
        kappa * cos,
        -B / J,
        -kappa * (x[1] * sin + x[0] * cos),
        -p / J,
    )
    for i in range(5):
        for j in range(5):
            F[i, j] = M[i, j] = 0.0
    for j in range(5):
        d_turn = 0.5 * tau * tau * da[j] + (tau if j == 2 else 0.0)
        F[0, j] = -i_b * d_turn
        F[1, j] = i_a * d_turn
        F[2, j] = tau * da[j]
        F[3, j] = d_turn
    F[0, 0] += cos_t
    F[0, 1] -= sin_t
    F[1, 0] += sin_t
    F[1, 1] += cos_t
    F[2, 2] += 1.0
    F[3, 3] += 1.0
    F[4, 4] = 1.0
    for i in range(5):
        for j in range(5):
            for k in range(5):
                M[i, j] += F[i, k] * P[k, j]
    for i in range(5):
        for j in range(i, 5):
            total = n_gap * Q[i] if i == j else 0.0
            for k in range(5):
                total += M[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total
    # The torque meanwhile, in speed and angle; the currents at the end, for themselves.
    g_w = kappa * tau
    g_t = 0.5 * kappa * tau * tau
    P[2, 2] += var * g_w * g_w
    P[2, 3] += var * g_w * g_t
    P[3, 2] = P[2, 3]
    P[3, 3] += var * g_t * g_t
    P[0, 0] += var
    P[1, 1] += var
    x[0] = i_a
    x[1] = i_b
    x[2] += tau * a
    x[3] = wrap(x[3] + turn)


@lean
def _update(R: Array, y: Array, x: Array, P: Array, K: Array, W: Array) -> float:
    """`ekf.update` on work arrays, Joseph form; K (5, 2) and W (5, 5) are scratch. Gives nis."""
    s00 = P[0, 0] + R[0]
    s11 = P[1, 1] + R[1]
    s01 = P[0, 1]
    det = s00 * s11 - s01 * s01
    if not det > 0.0:
        # Written by hand because 1 / 0 raises here.
        x[0] = math.nan
        return math.nan
    inv = 1.0 / det
    nu0 = y[0] - x[0]
    nu1 = y[1] - x[1]
    nis: float = (s11 * nu0 * nu0 - 2.0 * s01 * nu0 * nu1 + s00 * nu1 * nu1) * inv
    for i in range(5):
        K[i, 0] = (P[i, 0] * s11 - P[i, 1] * s01) * inv
        K[i, 1] = (P[i, 1] * s00 - P[i, 0] * s01) * inv
    for i in range(5):
        for j in range(5):
            W[i, j] = P[i, j] - K[i, 0] * P[0, j] - K[i, 1] * P[1, j]
    for i in range(5):
        x[i] += K[i, 0] * nu0 + K[i, 1] * nu1
        for j in range(i, 5):
            value = W[i, j] - W[i, 0] * K[j, 0] - W[i, 1] * K[j, 1]
            value += K[i, 0] * R[0] * K[j, 0] + K[i, 1] * R[1] * K[j, 1]
            P[i, j] = value
            P[j, i] = value
        if 0.0 <= P[i, i] < _FLOOR:
            P[i, i] = _FLOOR
    x[3] = wrap(x[3])
    return nis


@lean
def _turning(u: Array, w: float, n_sub: int, dt: float) -> tuple[float, float, float, float]:
    """`pmsm.turning`: the first sub-step's voltage, and cosine and sine from one to the next."""
    h = 0.5 * dt * w
    if n_sub < 2 or h == 0.0 or not abs(n_sub * h) <= _TURN_MAX:
        return u[0], u[1], 1.0, 0.0
    gain = n_sub * math.sin(h) / math.sin(n_sub * h)
    back = -h * (n_sub - 1)
    cos, sin = gain * math.cos(back), gain * math.sin(back)
    first_a = cos * u[0] - sin * u[1]
    first_b = sin * u[0] + cos * u[1]
    return first_a, first_b, math.cos(2.0 * h), math.sin(2.0 * h)


@lean
def _ekf_predict(par: Array, Q: Array, u: Array, n_sub: int, dt: float, x: Array, P: Array) -> None:
    """`ekf.predict` on work arrays; f.. are the entries of the Jacobian, m.. of F P."""
    R_s, L_s, psi_f = par[0], par[1], par[2]
    p, J, B, k_p = par[3], par[4], par[5], par[6]
    a = 1.0 - R_s / L_s * dt
    b = psi_f / L_s * dt
    f22 = 1.0 - B / J * dt
    e = k_p * p * p * psi_f / J * dt
    f24 = -p * dt / J
    v0, v1, cos_v, sin_v = _turning(u, x[2], n_sub, dt)
    v0 *= dt / L_s
    v1 *= dt / L_s
    q0, q1, q2, q3, q4 = Q[0], Q[1], Q[2], Q[3], Q[4]
    i_a, i_b, w, theta, load = x[0], x[1], x[2], x[3], x[4]
    p00, p01, p02, p03, p04 = P[0, 0], P[0, 1], P[0, 2], P[0, 3], P[0, 4]
    p11, p12, p13, p14 = P[1, 1], P[1, 2], P[1, 3], P[1, 4]
    p22, p23, p24 = P[2, 2], P[2, 3], P[2, 4]
    p33, p34, p44 = P[3, 3], P[3, 4], P[4, 4]
    for _ in range(n_sub):
        sin = math.sin(theta)
        cos = math.cos(theta)
        f02 = b * sin
        f03 = b * w * cos
        f12 = -b * cos
        f13 = b * w * sin
        f20 = -e * sin
        f21 = e * cos
        f23 = -e * (i_b * sin + i_a * cos)

        m00 = a * p00 + f02 * p02 + f03 * p03
        m01 = a * p01 + f02 * p12 + f03 * p13
        m02 = a * p02 + f02 * p22 + f03 * p23
        m03 = a * p03 + f02 * p23 + f03 * p33
        m04 = a * p04 + f02 * p24 + f03 * p34
        m10 = a * p01 + f12 * p02 + f13 * p03
        m11 = a * p11 + f12 * p12 + f13 * p13
        m12 = a * p12 + f12 * p22 + f13 * p23
        m13 = a * p13 + f12 * p23 + f13 * p33
        m14 = a * p14 + f12 * p24 + f13 * p34
        m20 = f20 * p00 + f21 * p01 + f22 * p02 + f23 * p03 + f24 * p04
        m21 = f20 * p01 + f21 * p11 + f22 * p12 + f23 * p13 + f24 * p14
        m22 = f20 * p02 + f21 * p12 + f22 * p22 + f23 * p23 + f24 * p24
        m23 = f20 * p03 + f21 * p13 + f22 * p23 + f23 * p33 + f24 * p34
        m24 = f20 * p04 + f21 * p14 + f22 * p24 + f23 * p34 + f24 * p44
        m32 = dt * p22 + p23
        m33 = dt * p23 + p33
        m34 = dt * p24 + p34

        p00 = a * m00 + f02 * m02 + f03 * m03 + q0
        p01 = a * m01 + f12 * m02 + f13 * m03
        p02 = f20 * m00 + f21 * m01 + f22 * m02 + f23 * m03 + f24 * m04
        p03 = dt * m02 + m03
        p04 = m04
        p11 = a * m11 + f12 * m12 + f13 * m13 + q1
        p12 = f20 * m10 + f21 * m11 + f22 * m12 + f23 * m13 + f24 * m14
        p13 = dt * m12 + m13
        p14 = m14
        p22 = f20 * m20 + f21 * m21 + f22 * m22 + f23 * m23 + f24 * m24 + q2
        p23 = dt * m22 + m23
        p24 = m24
        p33 = dt * m32 + m33 + q3
        p34 = m34
        p44 = p44 + q4

        i_a_next = a * i_a + f02 * w + v0
        i_b_next = a * i_b + f12 * w + v1
        w_next = f22 * w + e * (i_b * cos - i_a * sin) + f24 * load
        v0, v1 = cos_v * v0 - sin_v * v1, sin_v * v0 + cos_v * v1
        theta += w * dt
        i_a = i_a_next
        i_b = i_b_next
        w = w_next
    x[0], x[1], x[2], x[3] = i_a, i_b, w, wrap(theta)
    P[0, 0], P[0, 1], P[0, 2], P[0, 3], P[0, 4] = p00, p01, p02, p03, p04
    P[1, 0], P[1, 1], P[1, 2], P[1, 3], P[1, 4] = p01, p11, p12, p13, p14
    P[2, 0], P[2, 1], P[2, 2], P[2, 3], P[2, 4] = p02, p12, p22, p23, p24
    P[3, 0], P[3, 1], P[3, 2], P[3, 3], P[3, 4] = p03, p13, p23, p33, p34
    P[4, 0], P[4, 1], P[4, 2], P[4, 3], P[4, 4] = p04, p14, p24, p34, p44


@lean
def _leaned(u: Array, lean: float, half: float, x: Array, v: Array) -> None:
    """`ekf.leaned`: fills v (2,); half: half the interval, s."""
    v[0], v[1] = u[0], u[1]
    if lean != 0.0:
        angle = x[3] + half * x[2]
        v[0] += lean * math.sin(angle)
        v[1] -= lean * math.cos(angle)


@lean
def _cholesky(P: Array, relative: float, absolute: float, L: Array) -> bool:
    """Lower factor of P with its variances raised by relative and absolute; False if none."""
    for j in range(5):
        pivot = P[j, j] + (relative * abs(P[j, j]) + absolute)
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > 0.0:
            return False
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, 5):
            value = P[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value / L[j, j]
    return True


@lean
def _ukf_predict(
    par: Array,
    Q: Array,
    u: Array,
    n_sub: int,
    dt: float,
    kappa: float,
    x: Array,
    P: Array,
    L: Array,
    D: Array,
    shift: Array,
) -> bool:
    """`ukf.predict` on work arrays. False: no factor.

    L (5, 5), D (10, 5), shift (5,): scratch.
    """
    R_s, L_s, psi_f = par[0], par[1], par[2]
    p, J, B, k_p = par[3], par[4], par[5], par[6]
    theta_a = 1.0 - R_s / L_s * dt
    theta_b = psi_f / L_s * dt
    theta_d = 1.0 - B / J * dt
    theta_e = k_p * p * p * psi_f / J * dt
    theta_f = p * dt / J
    v0, v1, cos_v, sin_v = _turning(u, x[2], n_sub, dt)
    v0 *= dt / L_s
    v1 *= dt / L_s
    c = math.sqrt(5.0 + kappa)
    weight = 0.5 / (5.0 + kappa)
    weight_0 = kappa / (5.0 + kappa)
    for _ in range(n_sub):
        if not _cholesky(P, 0.0, 0.0, L) and not _cholesky(P, _REPAIR, _FLOOR, L):
            return False
        i_a, i_b, w, theta, load = x[0], x[1], x[2], x[3], x[4]
        sin, cos = math.sin(theta), math.cos(theta)
        f_a = theta_a * i_a + theta_b * w * sin + v0
        f_b = theta_a * i_b - theta_b * w * cos + v1
        f_w = theta_d * w + theta_e * (i_b * cos - i_a * sin) - theta_f * load
        f_t = theta + w * dt
        v0, v1, v0_now, v1_now = cos_v * v0 - sin_v * v1, sin_v * v0 + cos_v * v1, v0, v1
        for k in range(5):
            shift[k] = 0.0
        for j in range(5):
            d_a = c * L[0, j] if j < 1 else 0.0
            d_b = c * L[1, j] if j < 2 else 0.0
            d_w = c * L[2, j] if j < 3 else 0.0
            d_t = c * L[3, j] if j < 4 else 0.0
            d_l = c * L[4, j]
            # One sine and cosine serve both points of a pair.
            sin_d, cos_d = math.sin(d_t), math.cos(d_t)
            for side in range(2):
                g = 1.0 - 2.0 * side
                sin_j = sin * cos_d + g * cos * sin_d
                cos_j = cos * cos_d - g * sin * sin_d
                a_j = i_a + g * d_a
                b_j = i_b + g * d_b
                w_j = w + g * d_w
                row = j + 5 * side
                D[row, 0] = theta_a * a_j + theta_b * w_j * sin_j + v0_now - f_a
                D[row, 1] = theta_a * b_j - theta_b * w_j * cos_j + v1_now - f_b
                D[row, 2] = (
                    theta_d * w_j
                    + theta_e * (b_j * cos_j - a_j * sin_j)
                    - theta_f * (load + g * d_l)
                    - f_w
                )
                D[row, 3] = g * (d_t + d_w * dt)
                D[row, 4] = g * d_l
        for row in range(10):
            for k in range(5):
                shift[k] += weight * D[row, k]
        for i in range(5):
            for j in range(i, 5):
                total = 0.0
                for row in range(10):
                    total += (D[row, i] - shift[i]) * (D[row, j] - shift[j])
                total = weight * total + weight_0 * shift[i] * shift[j]
                if i == j:
                    total += Q[i]
                P[i, j] = total
                P[j, i] = total
        x[0] = f_a + shift[0]
        x[1] = f_b + shift[1]
        x[2] = f_w + shift[2]
        x[3] = f_t + shift[3]
        x[4] = load + shift[4]
    x[3] = wrap(x[3])
    return True
