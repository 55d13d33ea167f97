"""Sigma-mixed filter in NumPy, which `sigma_mixed.c` is compared with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tests.reference.mixture import expect_maximise

Array = NDArray[np.float64]

_N = 3
_POINTS = 2 * _N + 1
_ITERATIONS = 10
_FLOOR = 1e-4


def _root(P: Array, scale: float, L: Array) -> None:
    """Lower factor of scale * P (3, 3), symmetric positive definite."""
    L[:, :] = 0.0
    for j in range(_N):
        pivot = scale * P[j, j]
        for i in range(j):
            pivot -= L[j, i] * L[j, i]
        L[j, j] = math.sqrt(max(pivot, 1e-12))
        for i in range(j + 1, _N):
            value = scale * P[i, j]
            for n in range(j):
                value -= L[i, n] * L[j, n]
            L[i, j] = value / L[j, j]


def _sigma_points(x: Array, P: Array, kappa: float, L: Array, out: Array) -> None:
    """(19): out (7, 3)."""
    _root(P, _N + kappa, L)
    out[0] = x
    for i in range(_N):
        for p in range(_N):
            out[1 + i, p] = x[p] + L[p, i]
            out[1 + _N + i, p] = x[p] - L[p, i]


def sweep(
    y: Array, settled: Array, keep: Array, drift: Array, gap: Array, q: Array, r: Array,
    apart: Array, options: Array, state: Array, mixed: Array,
) -> None:  # fmt: skip
    """All samples of all motors; fills state (K, M, 3) and mixed (K, M).

    y, settled, keep (K, M, 3); drift, q, r (M, 3); gap (K,) s; settled: where the inputs drive a
    point; keep: share of the distance from there that is left after the gap; options: kappa,
    mixing, weighted.
    """
    kappa, mixing, weighted = options[0], options[1], options[2] > 0.5
    w0, w = kappa / (_N + kappa), 0.5 / (_N + kappa)
    x, P, L = np.empty(_N), np.empty((_N, _N)), np.empty((_N, _N))
    points, pool = np.empty((_POINTS, _N)), np.empty(_POINTS * _N)
    mixture = np.empty((3, _N))
    for m in range(y.shape[1]):
        P[:, :] = 0.0
        for p in range(_N):
            x[p] = y[0, m, p] if math.isfinite(y[0, m, p]) else settled[0, m, p]
            P[p, p] = r[m, p] + q[m, p]
        for k in range(y.shape[0]):
            _sigma_points(x, P, kappa, L, points)
            last = settled[k - 1, m] if k else settled[0, m]
            for i in range(_POINTS):
                for p in range(_N):
                    away = points[i, p] - last[p]
                    points[i, p] = settled[k, m, p] + keep[k, m, p] * away + drift[m, p] * gap[k]
            for p in range(_N):
                x[p] = w0 * points[0, p]
                for i in range(1, _POINTS):
                    x[p] += w * points[i, p]
            for a in range(_N):
                for b in range(_N):
                    c = w0 * (points[0, a] - x[a]) * (points[0, b] - x[b])
                    for i in range(1, _POINTS):
                        c += w * (points[i, a] - x[a]) * (points[i, b] - x[b])
                    P[a, b] = c
                P[a, a] += q[m, a] * (1.0 - keep[k, m, a] * keep[k, m, a])
            _sigma_points(x, P, kappa, L, points)
            for i in range(_POINTS):
                for p in range(_N):
                    pool[_N * i + p] = points[i, p] - apart[p]
            expect_maximise(pool, _ITERATIONS, _FLOOR, mixture)
            common = 0.0
            for i in range(_N):
                common += mixture[0, i] * mixture[1, i] if weighted else mixture[1, i] / _N
            mean = (x.sum() - apart.sum()) / _N
            for p in range(_N):
                x[p] += mixing * (common - mean)
            for p in range(_N):
                if math.isfinite(y[k, m, p]):
                    _update(x, P, p, y[k, m, p], r[m, p])
            state[k, m] = x
            mixed[k, m] = common


def _update(x: Array, P: Array, p: int, reading: float, r: float) -> None:
    """(28) for one point's reading: y = x_p + v, so that P_xy is a column of P."""
    s = P[p, p] + r
    nu = reading - x[p]
    column = P[:, p].copy()
    for a in range(_N):
        x[a] += column[a] / s * nu
        for b in range(_N):
            P[a, b] -= column[a] * column[b] / s
