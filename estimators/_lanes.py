"""Where a block of `LANES` drives keeps its numbers, and what the kernels of both filters share.

Drives are independent and do the same arithmetic, so one instruction can serve several of them.
What a compiler needs for that: a loop over lanes without calls or branches, and memory that cannot
overlap, so everything of a block of drives lies in one flat array, row by row, a lane each. Sines
are polynomials (fdlibm's, 1e-16 of their own), products are fused with sums: results differ from
the plain twins' by rounding only.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators._kernels import _TURN_MAX
from estimators._lean import lean

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32]
Flags = NDArray[np.bool_]

LANES: Final = 8
"""Two vector registers of AVX2: one alone waits for its own results, and is still half the work
where there are four drives or fewer."""
_L = LANES
_HALF = _L // 2
_LINE = 8
"""Numbers in a cache line."""
STATE: Final = 20
"""Rows of x (5) and of P's upper triangle (15)."""
_PAR, _Q, _R, _U, _LEAN, _V, _TURN, _Y = 20, 26, 31, 33, 35, 36, 38, 40
_NIS, _GOOD, _ROOT, _KEPT = 42, 43, 44, 45
ROWS: Final = _KEPT + STATE
"""Rows of a block: state, coefficients, noise, voltage as it is and as it turns, what comes out,
whether every P had a factor (UKF), and the state before the sample."""


class LanesRoom(NamedTuple):
    """Scratch of the loops, of no meaning between calls: B blocks of lanes, and one drive's own.

    work (B, ROWS * LANES); row_of (B * LANES,): the row that a lane works on; x (5,), P, F, W and
    L (5, 5), K (5, 2), v (2,), shift (5,), D (10, 5): a drive's that is done alone.
    """

    work: Array
    row_of: Ints
    x: Array
    P: Array
    F: Array
    W: Array
    L: Array
    K: Array
    v: Array
    shift: Array
    D: Array


def lanes_room(drives: int) -> LanesRoom:
    """Of so many drives."""
    blocks = (drives + LANES - 1) // LANES
    P, F, W, L = (np.zeros((5, 5)) for _ in range(4))
    return LanesRoom(
        _aligned(blocks, ROWS * LANES), np.full(blocks * LANES, -1), np.zeros(5), P, F, W, L,
        np.zeros((5, 2)), np.zeros(2), np.zeros(5), np.zeros((10, 5)),
    )  # fmt: skip


def _aligned(rows: int, columns: int) -> Array:
    """Zeros from a cache line's start on: a vector that lies across two costs a tenth of a step."""
    room = np.zeros(rows * columns + _LINE)
    skip = -room.ctypes.data // room.itemsize % _LINE
    return room[skip : skip + rows * columns].reshape(rows, columns)


_TWO_OVER_PI, _PI_2, _PI_2_REST = 2.0 / math.pi, 1.5707963267948966, 6.123233995736766e-17
_TURNS = 1.0 / (2.0 * math.pi)
_TWO_PI = 2.0 * math.pi
# Places are unsigned where there is little else to do: numba asks of others whether they count from
# the end.
_BLOCK, _LANE = np.uint64(_L.bit_length() - 1), np.uint64(_L - 1)
_GOOD_0, _NIS_0 = np.uint64(_GOOD * _L), np.uint64(_NIS * _L)
_U_0, _U_1, _Y_0, _Y_1 = (np.uint64(row * _L) for row in (_U, _U + 1, _Y, _Y + 1))


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _sincos(t: float) -> tuple[float, float]:
    """Of |t| < 1e6 to 2e-16; of numbers beyond any angle no number, or a wrong one."""
    q = np.floor(t * _TWO_OVER_PI + 0.5)
    r = (t - q * _PI_2) - q * _PI_2_REST
    z = r * r
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = 2.75573137070700676789e-06 + z * s
    s = -1.98412698298579493134e-04 + z * s
    s = 8.33333333332248946124e-03 + z * s
    s = r + r * z * (-1.66666666666666324348e-01 + z * s)
    c = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    c = -2.75573143513906633035e-07 + z * c
    c = 2.48015872894767294178e-05 + z * c
    c = -1.38888888888741095749e-03 + z * c
    c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * c)
    quadrant = q - 4.0 * np.floor(q * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sin = c if odd else s
    cos = s if odd else c
    sin = -sin if quadrant >= 2.0 else sin
    cos = -cos if (quadrant == 1.0) | (quadrant == 2.0) else cos
    return sin, cos


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _turning(s: Array, n_sub: int, dt: float) -> None:
    """`_kernels._leaned` and `_turning`: the first sub-step's voltage, and how it turns."""
    n, half = float(n_sub), 0.5 * n_sub * dt
    if n_sub == 1:
        # Within one sub-step it does not: three sines less.
        for k in range(_L):
            w, theta, lean = s[2 * _L + k], s[3 * _L + k], s[_LEAN * _L + k]
            sin, cos = _sincos(theta + half * w)
            scale = s[(_PAR + 5) * _L + k]
            s[_V * _L + k] = scale * (s[_U * _L + k] + lean * sin)
            s[(_V + 1) * _L + k] = scale * (s[(_U + 1) * _L + k] - lean * cos)
            s[_TURN * _L + k] = 1.0
            s[(_TURN + 1) * _L + k] = 0.0
        return
    for k in range(_L):
        w, theta, lean = s[2 * _L + k], s[3 * _L + k], s[_LEAN * _L + k]
        sin, cos = _sincos(theta + half * w)
        u0 = s[_U * _L + k] + lean * sin
        u1 = s[(_U + 1) * _L + k] - lean * cos
        h = 0.5 * dt * w
        sin_h, cos_h = _sincos(h)
        sin_n, _ = _sincos(n * h)
        sin_b, cos_b = _sincos(-h * (n - 1.0))
        turns = (n > 1.5) & (h != 0.0) & (abs(n * h) <= _TURN_MAX)
        gain = n * sin_h / sin_n
        v0 = gain * (cos_b * u0 - sin_b * u1) if turns else u0
        v1 = gain * (sin_b * u0 + cos_b * u1) if turns else u1
        scale = s[(_PAR + 5) * _L + k]
        s[_V * _L + k] = scale * v0
        s[(_V + 1) * _L + k] = scale * v1
        s[_TURN * _L + k] = 1.0 - 2.0 * sin_h * sin_h if turns else 1.0
        s[(_TURN + 1) * _L + k] = 2.0 * sin_h * cos_h if turns else 0.0


@lean
def _enter(s: Array, k: int, par: Array, Q: Array, R: Array, lean: float, dt: float) -> None:
    """What does not change of one drive, in lane k."""
    R_s, L_s, psi_f = par[0], par[1], par[2]
    p, J, B, k_p = par[3], par[4], par[5], par[6]
    s[_PAR * _L + k] = 1.0 - R_s / L_s * dt
    s[(_PAR + 1) * _L + k] = psi_f / L_s * dt
    s[(_PAR + 2) * _L + k] = 1.0 - B / J * dt
    s[(_PAR + 3) * _L + k] = k_p * p * p * psi_f / J * dt
    s[(_PAR + 4) * _L + k] = -p * dt / J
    s[(_PAR + 5) * _L + k] = dt / L_s
    for i in range(5):
        s[(_Q + i) * _L + k] = Q[i]
    s[_R * _L + k], s[(_R + 1) * _L + k] = R[0], R[1]
    s[_LEAN * _L + k] = lean


@lean
def _load(s: Array, k: int, x: Array, P: Array) -> None:
    """A drive's state into lane k."""
    row = 5
    for i in range(5):
        s[i * _L + k] = x[i]
        for j in range(i, 5):
            s[row * _L + k] = P[i, j]
            row += 1


@lean
def _store(s: Array, k: int, x: Array, P: Array) -> None:
    """And out of it."""
    row = 5
    for i in range(5):
        x[i] = s[i * _L + k]
        for j in range(i, 5):
            P[i, j] = P[j, i] = s[row * _L + k]
            row += 1


@lean
def _healthy(x: Array, P: Array) -> bool:
    """Finite, and no variance negative."""
    total = 0.0
    for i in range(5):
        total += x[i]
        if not P[i, i] >= 0.0:
            return False
        for j in range(i, 5):
            total += P[i, j]
    return math.isfinite(total)


@lean
def _settle(s: Array, b: int, row_of: Ints, nis_out: Array, ok_out: Flags) -> None:
    """After a round of block b: what became of its rows; lanes without one are as before."""
    for k in range(_L):
        d = np.uint64(b * _L + k)
        lane = np.uint64(k)
        row = row_of[d]
        row_of[d] = -1
        if row >= 0 and ok_out[d] and s[_GOOD_0 + lane] == 1.0:
            nis_out[np.uint64(row)] = s[_NIS_0 + lane]
            continue
        for i in range(STATE):
            s[i * _L + k] = s[(_KEPT + i) * _L + k]
        if row >= 0:
            ok_out[d] = False


@lean
def _gather(
    work: Array, row_of: Ints, i: int, drive: Drives, u: Array, y: Array, n_sub: Ints, n_gap: Ints
) -> int:
    """Rows from i on into their lanes, as many as can be done together; gives the next one."""
    steps = n_sub[i]
    while i < drive.shape[0]:
        r = np.uint64(i)
        d = np.uint64(drive[r])
        if n_gap[r] != 0 or n_sub[r] != steps or row_of[d] >= 0:
            break
        row_of[d] = i
        s, k = work[d >> _BLOCK], d & _LANE
        s[k + _U_0], s[k + _U_1] = u[r, 0], u[r, 1]
        s[k + _Y_0], s[k + _Y_1] = y[r, 0], y[r, 1]
        i += 1
    return i
