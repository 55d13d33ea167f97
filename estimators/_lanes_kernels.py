"""EKF and UKF of several drives at once, in vectors of drives: see `_lanes` for how.

Plain twins: `ekf.sweep`, `ukf.sweep`. Written out for the same reason, and as long, as `_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators._kernels import _FLOOR, _coast, _ekf_predict, _leaned, _ukf_predict, _update
from estimators._lanes import (
    _GOOD,
    _HALF,
    _KEPT,
    _L,
    _NIS,
    _PAR,
    _Q,
    _R,
    _ROOT,
    _TURN,
    _TURNS,
    _TWO_PI,
    _U,
    _V,
    _Y,
    STATE,
    LanesRoom,
    _enter,
    _gather,
    _healthy,
    _load,
    _settle,
    _sincos,
    _store,
    _turning,
)  # fmt: skip
from estimators._lanes_unscented import _predict_unscented
from estimators._lean import fused, lean

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32]
Flags = NDArray[np.bool_]


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _predict(s: Array, dt: float, first: int, last: int) -> None:
    """One sub-step of `_kernels._ekf_predict`, lanes first to last; the angle is not wrapped."""
    for k in range(first, last):
        a, b, f22 = s[_PAR * _L + k], s[(_PAR + 1) * _L + k], s[(_PAR + 2) * _L + k]
        e, f24 = s[(_PAR + 3) * _L + k], s[(_PAR + 4) * _L + k]
        i_a, i_b, w, theta, load = s[k], s[_L + k], s[2 * _L + k], s[3 * _L + k], s[4 * _L + k]
        p00, p01, p02 = s[5 * _L + k], s[6 * _L + k], s[7 * _L + k]
        p03, p04 = s[8 * _L + k], s[9 * _L + k]
        p11, p12, p13 = s[10 * _L + k], s[11 * _L + k], s[12 * _L + k]
        p14, p22, p23 = s[13 * _L + k], s[14 * _L + k], s[15 * _L + k]
        p24, p33, p34 = s[16 * _L + k], s[17 * _L + k], s[18 * _L + k]
        p44 = s[19 * _L + k]
        v0, v1 = s[_V * _L + k], s[(_V + 1) * _L + k]
        cos_v, sin_v = s[_TURN * _L + k], s[(_TURN + 1) * _L + k]
        sin, cos = _sincos(theta)
        f02, f03 = b * sin, b * w * cos
        f12, f13 = -b * cos, b * w * sin
        f20, f21 = -e * sin, e * cos
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
        m32, m33, m34 = dt * p22 + p23, dt * p23 + p33, dt * p24 + p34

        s[5 * _L + k] = a * m00 + f02 * m02 + f03 * m03 + s[_Q * _L + k]
        s[6 * _L + k] = a * m01 + f12 * m02 + f13 * m03
        s[7 * _L + k] = f20 * m00 + f21 * m01 + f22 * m02 + f23 * m03 + f24 * m04
        s[8 * _L + k] = dt * m02 + m03
        s[9 * _L + k] = m04
        s[10 * _L + k] = a * m11 + f12 * m12 + f13 * m13 + s[(_Q + 1) * _L + k]
        s[11 * _L + k] = f20 * m10 + f21 * m11 + f22 * m12 + f23 * m13 + f24 * m14
        s[12 * _L + k] = dt * m12 + m13
        s[13 * _L + k] = m14
        s[14 * _L + k] = (
            f20 * m20 + f21 * m21 + f22 * m22 + f23 * m23 + f24 * m24 + s[(_Q + 2) * _L + k]
        )
        s[15 * _L + k] = dt * m22 + m23
        s[16 * _L + k] = m24
        s[17 * _L + k] = dt * m32 + m33 + s[(_Q + 3) * _L + k]
        s[18 * _L + k] = m34
        s[19 * _L + k] = p44 + s[(_Q + 4) * _L + k]

        s[k] = a * i_a + f02 * w + v0
        s[_L + k] = a * i_b + f12 * w + v1
        s[2 * _L + k] = f22 * w + e * (i_b * cos - i_a * sin) + f24 * load
        s[3 * _L + k] = theta + w * dt
        s[_V * _L + k] = cos_v * v0 - sin_v * v1
        s[(_V + 1) * _L + k] = sin_v * v0 + cos_v * v1


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _correct(s: Array, lanes: int) -> None:
    """`_kernels._update` and what `_store` asks for; bad lanes are told, not undone."""
    for k in range(lanes):
        p00, p01, p02 = s[5 * _L + k], s[6 * _L + k], s[7 * _L + k]
        p03, p04 = s[8 * _L + k], s[9 * _L + k]
        p11, p12, p13 = s[10 * _L + k], s[11 * _L + k], s[12 * _L + k]
        p14, p22, p23 = s[13 * _L + k], s[14 * _L + k], s[15 * _L + k]
        p24, p33, p34 = s[16 * _L + k], s[17 * _L + k], s[18 * _L + k]
        p44 = s[19 * _L + k]
        r0, r1 = s[_R * _L + k], s[(_R + 1) * _L + k]
        s00, s11 = p00 + r0, p11 + r1
        det = s00 * s11 - p01 * p01
        inv = 1.0 / det
        nu0, nu1 = s[_Y * _L + k] - s[k], s[(_Y + 1) * _L + k] - s[_L + k]
        i00, i01, i11 = s11 * inv, -p01 * inv, s00 * inv
        k00, k01 = p00 * i00 + p01 * i01, p00 * i01 + p01 * i11
        k10, k11 = p01 * i00 + p11 * i01, p01 * i01 + p11 * i11
        k20, k21 = p02 * i00 + p12 * i01, p02 * i01 + p12 * i11
        k30, k31 = p03 * i00 + p13 * i01, p03 * i01 + p13 * i11
        k40, k41 = p04 * i00 + p14 * i01, p04 * i01 + p14 * i11

        # Joseph: (I - K H) P, then less its first columns times K', plus K R K'.
        w00, w01 = p00 - k00 * p00 - k01 * p01, p01 - k00 * p01 - k01 * p11
        w02, w03 = p02 - k00 * p02 - k01 * p12, p03 - k00 * p03 - k01 * p13
        w04 = p04 - k00 * p04 - k01 * p14
        w10, w11 = p01 - k10 * p00 - k11 * p01, p11 - k10 * p01 - k11 * p11
        w12, w13 = p12 - k10 * p02 - k11 * p12, p13 - k10 * p03 - k11 * p13
        w14 = p14 - k10 * p04 - k11 * p14
        w20, w21 = p02 - k20 * p00 - k21 * p01, p12 - k20 * p01 - k21 * p11
        w22, w23 = p22 - k20 * p02 - k21 * p12, p23 - k20 * p03 - k21 * p13
        w24 = p24 - k20 * p04 - k21 * p14
        w30, w31 = p03 - k30 * p00 - k31 * p01, p13 - k30 * p01 - k31 * p11
        w33, w34 = p33 - k30 * p03 - k31 * p13, p34 - k30 * p04 - k31 * p14
        w40, w41 = p04 - k40 * p00 - k41 * p01, p14 - k40 * p01 - k41 * p11
        w44 = p44 - k40 * p04 - k41 * p14
        a00, a01 = k00 * r0 - w00, k01 * r1 - w01
        a10, a11 = k10 * r0 - w10, k11 * r1 - w11
        a20, a21 = k20 * r0 - w20, k21 * r1 - w21
        a30, a31 = k30 * r0 - w30, k31 * r1 - w31
        a40, a41 = k40 * r0 - w40, k41 * r1 - w41
        t00, t01 = w00 + a00 * k00 + a01 * k01, w01 + a00 * k10 + a01 * k11
        t02, t03 = w02 + a00 * k20 + a01 * k21, w03 + a00 * k30 + a01 * k31
        t04 = w04 + a00 * k40 + a01 * k41
        t11, t12 = w11 + a10 * k10 + a11 * k11, w12 + a10 * k20 + a11 * k21
        t13, t14 = w13 + a10 * k30 + a11 * k31, w14 + a10 * k40 + a11 * k41
        t22, t23 = w22 + a20 * k20 + a21 * k21, w23 + a20 * k30 + a21 * k31
        t24 = w24 + a20 * k40 + a21 * k41
        t33, t34 = w33 + a30 * k30 + a31 * k31, w34 + a30 * k40 + a31 * k41
        t44 = w44 + a40 * k40 + a41 * k41

        x0, x1 = s[k] + k00 * nu0 + k01 * nu1, s[_L + k] + k10 * nu0 + k11 * nu1
        x2, x3 = s[2 * _L + k] + k20 * nu0 + k21 * nu1, s[3 * _L + k] + k30 * nu0 + k31 * nu1
        x4 = s[4 * _L + k] + k40 * nu0 + k41 * nu1
        x3 = x3 - _TWO_PI * np.ceil((x3 - math.pi) * _TURNS)
        # NaN and infinity survive any sum; short ones do not wait for one another.
        total = ((x0 + x1) + (x2 + x3)) + ((x4 + t00) + (t01 + t02)) + ((t03 + t04) + (t11 + t12))
        total = total + (((t13 + t14) + (t22 + t23)) + ((t24 + t33) + (t34 + t44)))
        good = (total - total == 0.0) & (det > 0.0) & (t00 >= 0.0) & (t11 >= 0.0)
        good = good & (t22 >= 0.0) & (t33 >= 0.0) & (t44 >= 0.0)
        s[_GOOD * _L + k] = 1.0 if good else 0.0
        s[_NIS * _L + k] = i00 * nu0 * nu0 + 2.0 * i01 * nu0 * nu1 + i11 * nu1 * nu1
        s[k], s[_L + k], s[2 * _L + k], s[3 * _L + k], s[4 * _L + k] = x0, x1, x2, x3, x4
        s[5 * _L + k], s[10 * _L + k] = max(t00, _FLOOR), max(t11, _FLOOR)
        s[14 * _L + k], s[17 * _L + k] = max(t22, _FLOOR), max(t33, _FLOOR)
        s[19 * _L + k] = max(t44, _FLOOR)
        s[6 * _L + k], s[7 * _L + k], s[8 * _L + k], s[9 * _L + k] = t01, t02, t03, t04
        s[11 * _L + k], s[12 * _L + k], s[13 * _L + k] = t12, t13, t14
        s[15 * _L + k], s[16 * _L + k], s[18 * _L + k] = t23, t24, t34


@fused
def _block(s: Array, n_sub: int, dt: float, wide: bool) -> None:
    """One sample of all lanes; of the first half where nothing is in the other.

    A sub-step of all does not fit into a processor's registers: many are done half by half.
    """
    for k in range(STATE * _L):
        s[_KEPT * _L + k] = s[k]
    _turning(s, n_sub, dt)
    if wide and n_sub == 1:
        _predict(s, dt, 0, _L)
    else:
        for _ in range(n_sub):
            _predict(s, dt, 0, _HALF)
        if wide:
            for _ in range(n_sub):
                _predict(s, dt, _HALF, _L)
    if wide:
        _correct(s, _L)
    else:
        _correct(s, _HALF)


@fused
def _block_unscented(s: Array, n_sub: int, dt: float, kappa: float, wide: bool) -> None:
    """The same by the UKF. Lanes whose covariance had no factor are told in row `_ROOT`."""
    for k in range(STATE * _L):
        s[_KEPT * _L + k] = s[k]
    for k in range(_L):
        s[_ROOT * _L + k] = 1.0
    _turning(s, n_sub, dt)
    reach, weight = math.sqrt(5.0 + kappa), 0.5 / (5.0 + kappa)
    if wide:
        for _ in range(n_sub):
            _predict_unscented(s, dt, reach, weight, kappa / (5.0 + kappa), _L)
        _correct(s, _L)
    else:
        for _ in range(n_sub):
            _predict_unscented(s, dt, reach, weight, kappa / (5.0 + kappa), _HALF)
        _correct(s, _HALF)


@lean
def _alone(
    par: Array, Q: Array, R: Array, var: float, lean: float, u: Array, y: Array, n_sub: int,
    n_gap: int, dt: float, kappa: float | None, room: LanesRoom,
) -> float:  # fmt: skip
    """A sample of the drive in `room`, behind a gap or to be repaired: not worth a vector.

    By the EKF where kappa is None; NaN for no factor.
    """
    x, P, v = room.x, room.P, room.v
    if n_gap > 0:
        _coast(par, Q, var, n_gap * dt, n_gap, x, P, room.F, room.W)
    _leaned(u, lean, 0.5 * n_sub * dt, x, v)
    if kappa is None:
        _ekf_predict(par, Q, v, n_sub, dt, x, P)
    elif not _ukf_predict(par, Q, v, n_sub, dt, kappa, x, P, room.L, room.D, room.shift):
        x[0] = math.nan
        return math.nan
    return _update(R, y, x, P, room.K, room.W)


@lean
def _round(
    work: Array, row_of: Ints, b: int, n_sub: int, dt: float, kappa: float | None, nis_out: Array,
    ok_out: Flags,
) -> int:  # fmt: skip
    """One sample of every block from b on; gives the first that wants a repair, not settled yet."""
    while b < work.shape[0]:
        wanted, wide, broken = False, False, False
        for k in range(_L):
            mine = row_of[np.uint64(b * _L + k)] >= 0
            wanted |= mine
            wide |= mine and k >= _HALF
        if wanted:
            if kappa is None:
                _block(work[b], n_sub, dt, wide)
            else:
                _block_unscented(work[b], n_sub, dt, kappa, wide)
                for k in range(_L):
                    broken |= row_of[b * _L + k] >= 0 and work[b, _ROOT * _L + k] == 0.0
                if broken:
                    return b
            _settle(work[b], b, row_of, nis_out, ok_out)
        b += 1
    return b


@lean
def _fill(
    work: Array, par: Array, Q: Array, R: Array, lean: Array, dt: float, x: Array, P: Array
) -> None:
    """All drives into their lanes; one without a drive calculates what the last drive does."""
    for d in range(work.shape[0] * _L):
        m = min(d, x.shape[0] - 1)
        _enter(work[d // _L], d % _L, par[m], Q[m], R[m], lean[m], dt)
        _load(work[d // _L], d % _L, x[m], P[m])
        for i in range(2):
            work[d // _L, (_U + i) * _L + d % _L] = work[d // _L, (_Y + i) * _L + d % _L] = 0.0


@lean
def _empty(work: Array, x: Array, P: Array) -> None:
    """And out of them."""
    for d in range(x.shape[0]):
        _store(work[d // _L], d % _L, x[d], P[d])


@lean
def _lanes(
    par: Array, Q: Array, R: Array, coast: Array, x: Array, P: Array, drive: Drives, u: Array,
    y: Array, n_sub: Ints, n_gap: Ints, dt: float, kappa: float | None, nis_out: Array,
    ok_out: Flags, lean: Array, room: LanesRoom,
) -> None:  # fmt: skip
    """Both filters' loop; the EKF where kappa is None: the other's code is then left out."""
    work, row_of, x_d, P_d = room.work, room.row_of, room.x, room.P
    rows, blocks = drive.shape[0], work.shape[0]
    row_of[:] = -1
    _fill(work, par, Q, R, lean, dt, x, P)
    nis_out[:] = np.nan
    ok_out[:] = True
    i = 0
    while i < rows:
        first, d = i, drive[i]
        if n_gap[i] > 0:
            i += 1
            if not ok_out[d]:
                continue
            s, k = work[d // _L], d % _L
            _store(s, k, x_d, P_d)
            nis = _alone(
                par[d], Q[d], R[d], coast[d], lean[d], u[first], y[first], n_sub[first],
                n_gap[first], dt, kappa, room,
            )  # fmt: skip
            ok_out[d] = _healthy(x_d, P_d)
            if ok_out[d]:
                nis_out[first] = nis
                _load(s, k, x_d, P_d)
            continue
        i = _gather(work, row_of, i, drive, u, y, n_sub, n_gap)
        b = _round(work, row_of, 0, n_sub[first], dt, kappa, nis_out, ok_out)
        while b < blocks:
            s = work[b]
            for k in range(_L):
                row = row_of[b * _L + k]
                if s[_ROOT * _L + k] != 0.0 or row < 0:
                    continue
                # Once more, with the covariance repaired.
                d = drive[row]
                _store(s[_KEPT * _L :], k, x_d, P_d)
                s[_NIS * _L + k] = _alone(
                    par[d], Q[d], R[d], coast[d], lean[d], u[row], y[row], n_sub[row], 0, dt,
                    kappa, room,
                )  # fmt: skip
                s[_GOOD * _L + k] = 1.0 if _healthy(x_d, P_d) else 0.0
                _load(s, k, x_d, P_d)
            _settle(s, b, row_of, nis_out, ok_out)
            b = _round(work, row_of, b + 1, n_sub[first], dt, kappa, nis_out, ok_out)
    _empty(work, x, P)


@lean
def ekf_lanes(
    par: Array, Q: Array, R: Array, coast: Array, x: Array, P: Array, drive: Drives, u: Array,
    y: Array, n_sub: Ints, n_gap: Ints, dt: float, nis_out: Array, ok_out: Flags, lean: Array,
    room: LanesRoom,
) -> None:  # fmt: skip
    """Run the EKF over M samples; x (N, 5) and P (N, 5, 5) in place. Twin: `ekf.sweep`.

    par (N, 7) as `pmsm.table`; Q (N, 5), R (N, 2), coast (N,) as `pmsm.Noise`; lean (N,), V, as
    in `ekf.leaned`; room: `lanes_room(N)`. nis_out (M,) and ok_out (N,) are filled. A drive whose
    result is not finite, or has a negative variance, gets ok False, keeps its last good x and P,
    and its later rows are skipped with nis NaN: start it anew.

    Rows that follow one another are done together while they are of different drives, without a
    gap and of one length; a drive's own rows keep their order. P comes out symmetric.
    """
    _lanes(par, Q, R, coast, x, P, drive, u, y, n_sub, n_gap, dt, None, nis_out, ok_out, lean, room)


@lean
def ukf_lanes(
    par: Array, Q: Array, R: Array, coast: Array, x: Array, P: Array, drive: Drives, u: Array,
    y: Array, n_sub: Ints, n_gap: Ints, dt: float, kappa: float, nis_out: Array, ok_out: Flags,
    lean: Array, room: LanesRoom,
) -> None:  # fmt: skip
    """Run the UKF over M samples: everything as in `ekf_lanes`. Twin: `ukf.sweep`.

    A covariance without a Cholesky factor is repaired once as `ukf.factor` says; if that fails too,
    the drive gets ok False.
    """
    _lanes(
        par, Q, R, coast, x, P, drive, u, y, n_sub, n_gap, dt, kappa, nis_out, ok_out, lean, room
    )
