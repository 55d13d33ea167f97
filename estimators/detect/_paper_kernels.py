# mypy: disallow-untyped-decorators=False
"""Compiled single-tick loops of the paper's detectors, D = 1.

`paper_vb.infer` and `message_passing.infer` are the NumPy twins, over whole records; for one
tick of a handful of drives they spend two to seven milliseconds in call overhead.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import njit, symbol

Array = NDArray[np.float64]
LOG_2PI = math.log(2.0 * math.pi)
digamma = symbol("digamma")


@njit(cache=True, error_model="numpy")
def _entropy(r1: Array) -> float:
    total = 0.0
    for p in r1:
        if 0.0 < p < 1.0:
            total -= p * math.log(p) + (1.0 - p) * math.log(1.0 - p)
    return total


@njit(cache=True, error_model="numpy")
def _beta_divergence(alpha: Array, prior: Array) -> float:
    """KL of a beta factor from its prior, both as (2,)."""
    total = alpha[0] + alpha[1]
    level = digamma(total)
    out = math.lgamma(total) - math.lgamma(prior[0] + prior[1])
    for k in range(2):
        out += math.lgamma(prior[k]) - math.lgamma(alpha[k])
        out += (alpha[k] - prior[k]) * (digamma(alpha[k]) - level)
    return out


@njit(cache=True, error_model="numpy")
def vb(
    x: Array, prior: Array, q: Array, sweeps: int, tolerance: float, r1: Array, bound: Array
) -> int:
    """`paper_vb.infer` for one tick of x (N,); the number of sweeps made.

    prior and q (5, 2): rows m, beta, W_inv, nu, alpha; q holds the start and then the result.
    Fills r1 (N,) and bound (S, 2). tolerance < 0: exactly `sweeps`.
    """
    n = x.shape[0]
    peak = np.empty(2)
    before = 0.0
    after = 0.0
    for s in range(sweeps):
        _levels(q, peak)
        for i in range(n):
            d0 = x[i] - q[0, 0]
            d1 = x[i] - q[0, 1]
            z = peak[1] - peak[0]
            z -= 0.5 * (q[3, 1] / q[2, 1] * d1 * d1 - q[3, 0] / q[2, 0] * d0 * d0)
            r1[i] = 1.0 / (1.0 + math.exp(-min(max(z, -745.0), 745.0)))
        bound[s, 0] = _drives(x, r1, q, peak) - _divergence(q, prior)
        if s == 0:
            before = bound[s, 0]
        for k in range(2):
            s0 = s1 = s2 = 0.0
            for i in range(n):
                r = r1[i] if k == 1 else 1.0 - r1[i]
                d = x[i] - prior[0, k]
                s0 += r
                s1 += r * d
                s2 += r * d * d
            q[1, k] = prior[1, k] + s0
            q[0, k] = prior[0, k] + s1 / q[1, k]
            q[2, k] = prior[2, k] + s2 - s1 * s1 / q[1, k]
            q[3, k] = prior[3, k] + s0
            q[4, k] = prior[4, k] + s0
        _levels(q, peak)
        after = _drives(x, r1, q, peak) - _divergence(q, prior)
        bound[s, 1] = after
        if tolerance >= 0.0 and not after - before >= tolerance * abs(after):
            bound[s + 1 :] = after
            return s + 1
        before = after
    return sweeps


@njit(cache=True, error_model="numpy")
def _levels(q: Array, peak: Array) -> None:
    total = digamma(q[4, 0] + q[4, 1])
    for k in range(2):
        log_lambda = digamma(0.5 * q[3, k]) + math.log(2.0) - math.log(q[2, k])
        peak[k] = digamma(q[4, k]) - total + 0.5 * (log_lambda - LOG_2PI - 1.0 / q[1, k])


@njit(cache=True, error_model="numpy")
def _drives(x: Array, r1: Array, q: Array, peak: Array) -> float:
    out = _entropy(r1)
    for i in range(x.shape[0]):
        for k in range(2):
            d = x[i] - q[0, k]
            r = r1[i] if k == 1 else 1.0 - r1[i]
            if r > 0.0:
                out += r * (peak[k] - 0.5 * q[3, k] / q[2, k] * d * d)
    return out


@njit(cache=True, error_model="numpy")
def _divergence(q: Array, prior: Array) -> float:
    out = _beta_divergence(q[4], prior[4])
    for k in range(2):
        step = q[0, k] - prior[0, k]
        ratio = prior[1, k] / q[1, k]
        out += 0.5 * (ratio - 1.0 - math.log(ratio))
        out += 0.5 * prior[1, k] * q[3, k] / q[2, k] * step * step
        log_q = math.log(q[2, k])
        out += 0.5 * (q[3, k] - prior[3, k]) * (digamma(0.5 * q[3, k]) - log_q)
        out += 0.5 * q[3, k] * (prior[2, k] / q[2, k] - 1.0)
        out += 0.5 * (q[3, k] * log_q - prior[3, k] * math.log(prior[2, k]))
        out += math.lgamma(0.5 * prior[3, k]) - math.lgamma(0.5 * q[3, k])
    return out


@njit(cache=True, error_model="numpy")
def vmp(
    x: Array,
    prior: Array,
    q: Array,
    order: NDArray[np.int64],
    sweeps: int,
    tolerance: float,
    r1: Array,
) -> int:
    """`message_passing.infer` for one tick of x (N,); the number of sweeps made.

    prior and q (5, 2): rows m, tau, a, b, alpha; q starts as the prior and holds the result.
    order (4,): 0 I, 1 pi, 2 mu, 3 Lambda. r1 (N,) holds the start and then E[I].
    tolerance < 0: exactly `sweeps`, and no bound is computed.
    """
    n = x.shape[0]
    before = 0.0
    for s in range(sweeps):
        for j in range(4):
            node = order[j]
            if node == 0:
                total = digamma(q[4, 0] + q[4, 1])
                level0 = digamma(q[4, 0]) - total + 0.5 * (digamma(q[2, 0]) - math.log(q[3, 0]))
                level1 = digamma(q[4, 1]) - total + 0.5 * (digamma(q[2, 1]) - math.log(q[3, 1]))
                for i in range(n):
                    e0 = (x[i] - q[0, 0]) ** 2 + 1.0 / q[1, 0]
                    e1 = (x[i] - q[0, 1]) ** 2 + 1.0 / q[1, 1]
                    z = level1 - level0 - 0.5 * (q[2, 1] / q[3, 1] * e1 - q[2, 0] / q[3, 0] * e0)
                    r1[i] = 1.0 / (1.0 + math.exp(-min(max(z, -745.0), 745.0)))
            for k in range(2):
                s0 = s1 = s2 = 0.0
                for i in range(n):
                    r = r1[i] if k == 1 else 1.0 - r1[i]
                    s0 += r
                    s1 += r * x[i]
                    s2 += r * ((x[i] - q[0, k]) ** 2 + 1.0 / q[1, k])
                if node == 1:
                    q[4, k] = prior[4, k] + s0
                elif node == 2:
                    precision = q[2, k] / q[3, k]
                    q[1, k] = prior[1, k] + precision * s0
                    q[0, k] = (prior[1, k] * prior[0, k] + precision * s1) / q[1, k]
                elif node == 3:
                    q[2, k] = prior[2, k] + 0.5 * s0
                    q[3, k] = prior[3, k] + 0.5 * s2
            if tolerance >= 0.0 and s == 0 and j == 0:
                before = _vmp_bound(x, prior, q, r1)
        if tolerance >= 0.0:
            after = _vmp_bound(x, prior, q, r1)
            if not after - before >= tolerance * abs(after):
                return s + 1
            before = after
    return sweeps


@njit(cache=True, error_model="numpy")
def _vmp_bound(x: Array, prior: Array, q: Array, r1: Array) -> float:
    out = _entropy(r1) - _beta_divergence(q[4], prior[4])
    total = digamma(q[4, 0] + q[4, 1])
    for k in range(2):
        log_lambda = digamma(q[2, k]) - math.log(q[3, k])
        precision = q[2, k] / q[3, k]
        level = digamma(q[4, k]) - total + 0.5 * (log_lambda - LOG_2PI)
        for i in range(x.shape[0]):
            r = r1[i] if k == 1 else 1.0 - r1[i]
            out += r * (level - 0.5 * precision * ((x[i] - q[0, k]) ** 2 + 1.0 / q[1, k]))
        ratio = prior[1, k] / q[1, k]
        step = q[0, k] - prior[0, k]
        out -= 0.5 * (ratio - 1.0 - math.log(ratio) + prior[1, k] * step * step)
        out -= (q[2, k] - prior[2, k]) * log_lambda - (q[3, k] - prior[3, k]) * precision
        out -= q[2, k] * math.log(q[3, k]) - prior[2, k] * math.log(prior[3, k])
        out -= math.lgamma(prior[2, k]) - math.lgamma(q[2, k])
    return out
