"""The UKF's prediction of several drives at once: see `_lanes` for how. Plain twin: `ukf.predict`.

The images of a pair of sigma points are told by their odd part o and their even part e: the pair's
deviations from the image of the mean are e + o and e - o, so that with s the mean's own shift

    (e + o - s)(e + o - s)' + (e - o - s)(e - o - s)' = 2 (o o' + (e - s)(e - s)').

Angle and load are linear: their e and s are zero. The factor is triangular: pair j moves none of
the states before it. That leaves a third of the products.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators._lanes import _L, _PAR, _Q, _ROOT, _TURN, _V, _sincos

Array = NDArray[np.float64]
Six = tuple[float, float, float, float, float, float]


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _pivot(value: float, good: float) -> tuple[float, float, float]:
    """Root of a pivot, its inverse, and whether all have been positive so far."""
    positive = value > 0.0
    root = math.sqrt(value if positive else 1.0)
    return root, 1.0 / root, good if positive else 0.0


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _pair(
    a: float, b: float, d: float, e: float, i_a: float, i_b: float, w: float, sin: float,
    cos: float, d_a: float, d_b: float, d_w: float, d_t: float,
) -> Six:  # fmt: skip
    """Odd and even parts of currents and speed for sigma points that far off; load left out.

    a, b, d, e: coefficients of the motor, as `_lanes._enter` keeps them.
    """
    sin_d, cos_d = _sincos(d_t)
    even_s, odd_s = sin * cos_d, cos * sin_d
    even_c, odd_c = cos * cos_d, -sin * sin_d
    o_a = a * d_a + b * (w * odd_s + d_w * even_s)
    e_a = b * (w * (even_s - sin) + d_w * odd_s)
    o_b = a * d_b - b * (w * odd_c + d_w * even_c)
    e_b = -b * (w * (even_c - cos) + d_w * odd_c)
    o_w = d * d_w + e * (i_b * odd_c + d_b * even_c - i_a * odd_s - d_a * even_s)
    e_w = e * (i_b * (even_c - cos) + d_b * odd_c - i_a * (even_s - sin) - d_a * odd_s)
    return o_a, e_a, o_b, e_b, o_w, e_w


@njit(inline="always", fastmath={"contract"}, error_model="numpy")
def _predict_unscented(
    s: Array, dt: float, reach: float, weight: float, weight_0: float, lanes: int
) -> None:
    """One sub-step of `_kernels._ukf_predict`, of the first lanes; the angle is not wrapped.

    reach: sqrt(5 + kappa); weight of a point, weight_0 of the mean. A lane whose P has no factor
    is told in row `_ROOT`.
    """
    for k in range(lanes):
        a, b, d = s[_PAR * _L + k], s[(_PAR + 1) * _L + k], s[(_PAR + 2) * _L + k]
        e, f = s[(_PAR + 3) * _L + k], s[(_PAR + 4) * _L + k]
        i_a, i_b, w, theta, load = s[k], s[_L + k], s[2 * _L + k], s[3 * _L + k], s[4 * _L + k]
        v0, v1 = s[_V * _L + k], s[(_V + 1) * _L + k]
        cos_v, sin_v = s[_TURN * _L + k], s[(_TURN + 1) * _L + k]

        good = s[_ROOT * _L + k]
        l00, r0, good = _pivot(s[5 * _L + k], good)
        l10, l20, l30 = s[6 * _L + k] * r0, s[7 * _L + k] * r0, s[8 * _L + k] * r0
        l40 = s[9 * _L + k] * r0
        l11, r1, good = _pivot(s[10 * _L + k] - l10 * l10, good)
        l21, l31 = (s[11 * _L + k] - l20 * l10) * r1, (s[12 * _L + k] - l30 * l10) * r1
        l41 = (s[13 * _L + k] - l40 * l10) * r1
        l22, r2, good = _pivot(s[14 * _L + k] - l20 * l20 - l21 * l21, good)
        l32 = (s[15 * _L + k] - l30 * l20 - l31 * l21) * r2
        l42 = (s[16 * _L + k] - l40 * l20 - l41 * l21) * r2
        l33, r3, good = _pivot(s[17 * _L + k] - l30 * l30 - l31 * l31 - l32 * l32, good)
        l43 = (s[18 * _L + k] - l40 * l30 - l41 * l31 - l42 * l32) * r3
        rest = s[19 * _L + k] - l40 * l40 - l41 * l41 - l42 * l42 - l43 * l43
        l44, _, good = _pivot(rest, good)
        s[_ROOT * _L + k] = good
        l00, l10, l20, l30, l40 = reach * l00, reach * l10, reach * l20, reach * l30, reach * l40
        l11, l21, l31, l41 = reach * l11, reach * l21, reach * l31, reach * l41
        l22, l32, l42 = reach * l22, reach * l32, reach * l42
        l33, l43, l44 = reach * l33, reach * l43, reach * l44

        sin, cos = _sincos(theta)
        a0, ea0, b0, eb0, w0, ew0 = _pair(
            a, b, d, e, i_a, i_b, w, sin, cos, l00, l10, l20, l30
        )  # fmt: skip
        a1, ea1, b1, eb1, w1, ew1 = _pair(a, b, d, e, i_a, i_b, w, sin, cos, 0.0, l11, l21, l31)
        a2, ea2, b2, eb2, w2, ew2 = _pair(a, b, d, e, i_a, i_b, w, sin, cos, 0.0, 0.0, l22, l32)
        a3, ea3, b3, eb3, w3, ew3 = _pair(a, b, d, e, i_a, i_b, w, sin, cos, 0.0, 0.0, 0.0, l33)
        w0, w1, w2, w3, w4 = w0 + f * l40, w1 + f * l41, w2 + f * l42, w3 + f * l43, f * l44
        t0, t1, t2, t3 = l30 + dt * l20, l31 + dt * l21, l32 + dt * l22, l33

        two = 2.0 * weight
        sa, sb = two * (ea0 + ea1 + ea2 + ea3), two * (eb0 + eb1 + eb2 + eb3)
        sw = two * (ew0 + ew1 + ew2 + ew3)
        # The fifth pair moves the load alone: its e is zero.
        ea0, ea1, ea2, ea3 = ea0 - sa, ea1 - sa, ea2 - sa, ea3 - sa
        eb0, eb1, eb2, eb3 = eb0 - sb, eb1 - sb, eb2 - sb, eb3 - sb
        ew0, ew1, ew2, ew3 = ew0 - sw, ew1 - sw, ew2 - sw, ew3 - sw
        aa = ea0 * ea0 + ea1 * ea1 + ea2 * ea2 + ea3 * ea3 + sa * sa
        ab = ea0 * eb0 + ea1 * eb1 + ea2 * eb2 + ea3 * eb3 + sa * sb
        aw = ea0 * ew0 + ea1 * ew1 + ea2 * ew2 + ea3 * ew3 + sa * sw
        bb = eb0 * eb0 + eb1 * eb1 + eb2 * eb2 + eb3 * eb3 + sb * sb
        bw = eb0 * ew0 + eb1 * ew1 + eb2 * ew2 + eb3 * ew3 + sb * sw
        ww = ew0 * ew0 + ew1 * ew1 + ew2 * ew2 + ew3 * ew3 + sw * sw
        aa = aa + a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3
        ab = ab + a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3
        aw = aw + a0 * w0 + a1 * w1 + a2 * w2 + a3 * w3
        bb = bb + b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3
        bw = bw + b0 * w0 + b1 * w1 + b2 * w2 + b3 * w3
        ww = ww + w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3 + w4 * w4

        s[5 * _L + k] = two * aa + weight_0 * sa * sa + s[_Q * _L + k]
        s[6 * _L + k] = two * ab + weight_0 * sa * sb
        s[7 * _L + k] = two * aw + weight_0 * sa * sw
        s[8 * _L + k] = two * (a0 * t0 + a1 * t1 + a2 * t2 + a3 * t3)
        s[9 * _L + k] = two * (a0 * l40 + a1 * l41 + a2 * l42 + a3 * l43)
        s[10 * _L + k] = two * bb + weight_0 * sb * sb + s[(_Q + 1) * _L + k]
        s[11 * _L + k] = two * bw + weight_0 * sb * sw
        s[12 * _L + k] = two * (b0 * t0 + b1 * t1 + b2 * t2 + b3 * t3)
        s[13 * _L + k] = two * (b0 * l40 + b1 * l41 + b2 * l42 + b3 * l43)
        s[14 * _L + k] = two * ww + weight_0 * sw * sw + s[(_Q + 2) * _L + k]
        s[15 * _L + k] = two * (w0 * t0 + w1 * t1 + w2 * t2 + w3 * t3)
        s[16 * _L + k] = two * (w0 * l40 + w1 * l41 + w2 * l42 + w3 * l43 + w4 * l44)
        s[17 * _L + k] = two * (t0 * t0 + t1 * t1 + t2 * t2 + t3 * t3) + s[(_Q + 3) * _L + k]
        s[18 * _L + k] = two * (t0 * l40 + t1 * l41 + t2 * l42 + t3 * l43)
        all_l = l40 * l40 + l41 * l41 + l42 * l42 + l43 * l43 + l44 * l44
        s[19 * _L + k] = two * all_l + s[(_Q + 4) * _L + k]

        s[k] = a * i_a + b * w * sin + v0 + sa
        s[_L + k] = a * i_b - b * w * cos + v1 + sb
        s[2 * _L + k] = d * w + e * (i_b * cos - i_a * sin) + f * load + sw
        s[3 * _L + k] = theta + w * dt
        s[_V * _L + k] = cos_v * v0 - sin_v * v1
        s[(_V + 1) * _L + k] = sin_v * v0 + cos_v * v1
