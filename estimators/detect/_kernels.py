"""Compiled loops of the variational detector; `variational.infer` is the NumPy twin.

The batch is a handful of drives, so the array form spends its time in call overhead:
470 us against 5 us here for three drives.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_STARTS = 16
"""Drives of the message set."""


@njit(cache=True)
def digamma(x: float) -> float:
    """Digamma for x > 0: recurrence up to 6, then the asymptotic series (error < 1e-13)."""
    shift = 0.0
    while x < 10.0:
        shift -= 1.0 / x
        x += 1.0
    y = 1.0 / (x * x)
    series = y * (
        1.0 / 12.0 - y * (1.0 / 120.0 - y * (1.0 / 252.0 - y * (1.0 / 240.0 - y * (1.0 / 132.0))))
    )
    return shift + math.log(x) - 0.5 / x - series


@njit(cache=True)
def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


@njit(cache=True)
def _one_start(
    x: Array, anchor: float, variance: float, priors: Array, sweeps: int, r1: Array
) -> tuple[float, float]:
    """Sweeps from one start; fills r1 (N,) and gives (mean of component 0, lower bound)."""
    n = x.shape[0]
    a = 0.5 * priors[0]
    alpha0, alpha1 = priors[3], priors[4]
    m = (anchor, 0.5 * anchor)
    b = (a * variance, a * (variance + anchor * anchor / 12.0))
    beta = (priors[1], priors[2])
    # a_k, b_k, m_k, 1/beta_k of both components: the priors before the first sweep.
    a0, b0, m0, v0 = a, b[0], m[0], 0.0
    a1, b1, m1, v1 = a, b[1], m[1], 0.0
    log_pi0 = digamma(alpha0) - digamma(alpha0 + alpha1)
    log_pi1 = digamma(alpha1) - digamma(alpha0 + alpha1)
    n0 = n1 = entropy = 0.0
    for sweep in range(sweeps):
        base0 = log_pi0 + 0.5 * (digamma(a0) - math.log(b0)) - 0.5 * v0
        base1 = log_pi1 + 0.5 * (digamma(a1) - math.log(b1)) - 0.5 * v1
        n1 = 0.0
        s0 = 0.0
        s1 = 0.0
        for i in range(n):
            d0 = x[i] - m0
            d1 = x[i] - m1
            z = base1 - base0 - 0.5 * (a1 / b1 * d1 * d1 - a0 / b0 * d0 * d0)
            p = 1.0 / (1.0 + math.exp(-min(max(z, -700.0), 700.0)))
            r1[i] = p
            n1 += p
            s1 += p * x[i]
            s0 += (1.0 - p) * x[i]
        if sweep == sweeps - 1:
            # Two logarithms a drive, and only the last bound is compared.
            for i in range(n):
                p = r1[i]
                q = 1.0 - p
                entropy -= p * math.log(max(p, 1e-300)) + q * math.log(max(q, 1e-300))
        n0 = n - n1
        mean0 = s0 / n0 if n0 > 1e-12 else m[0]
        mean1 = s1 / n1 if n1 > 1e-12 else m[1]
        q0 = 0.0
        q1 = 0.0
        for i in range(n):
            q0 += (1.0 - r1[i]) * (x[i] - mean0) ** 2
            q1 += r1[i] * (x[i] - mean1) ** 2
        v0 = 1.0 / (beta[0] + n0)
        v1 = 1.0 / (beta[1] + n1)
        m0 = (beta[0] * m[0] + n0 * mean0) * v0
        m1 = (beta[1] * m[1] + n1 * mean1) * v1
        a0 = a + 0.5 * n0
        a1 = a + 0.5 * n1
        b0 = b[0] + 0.5 * (q0 + beta[0] * n0 * (mean0 - m[0]) ** 2 * v0)
        b1 = b[1] + 0.5 * (q1 + beta[1] * n1 * (mean1 - m[1]) ** 2 * v1)
        total = digamma(alpha0 + alpha1 + n)
        log_pi0 = digamma(alpha0 + n0) - total
        log_pi1 = digamma(alpha1 + n1) - total
    bound = (
        entropy
        + math.lgamma(a0)
        - math.lgamma(a)
        + a * math.log(b[0])
        - a0 * math.log(b0)
        + 0.5 * math.log(beta[0] * v0)
        + math.lgamma(a1)
        - math.lgamma(a)
        + a * math.log(b[1])
        - a1 * math.log(b1)
        + 0.5 * math.log(beta[1] * v1)
        + _log_beta(alpha0 + n0, alpha1 + n1)
        - _log_beta(alpha0, alpha1)
        - 0.5 * n * math.log(2.0 * math.pi)
    )
    return m0, bound


@njit(cache=True)
def judge(
    load: Array,
    spread: Array,
    usable: NDArray[np.bool_],
    priors: Array,
    sweeps: int,
    lost: Array,
) -> float:
    """`VariationalDetector` on the usable drives; fills lost (N,), gives the common load."""
    n = load.shape[0]
    x = np.empty(n)
    m = 0
    variance = 0.0
    for i in range(n):
        lost[i] = 0.0
        if usable[i]:
            x[m] = load[i]
            variance += spread[i] * spread[i]
            m += 1
    if m < 2:
        return 0.0
    variance /= m
    r1 = np.empty(m)
    common = best_start(x[:m], variance, priors, sweeps, r1)
    # As much load as the others, or more, is not a lost wheel however odd it is.
    least = math.sqrt(variance)
    sign = 1.0 if common >= 0.0 else -1.0
    k = 0
    for i in range(n):
        if usable[i]:
            if (common - x[k]) * sign > least:
                lost[i] = r1[k]
            k += 1
    return common


@njit(cache=True)
def best_start(x: Array, variance: float, priors: Array, sweeps: int, r1: Array) -> float:
    """Start at every load in turn; keep the highest lower bound.

    x (N,), priors = (nu, beta_adhering, beta_lost, alpha_adhering, alpha_lost); fills r1 (N,)
    with E[I] and gives the mean of the adhering component. Ties keep the first start. Of more than
    `MOST_STARTS` loads so many, evenly by rank: the cost per drive stays what it is.
    """
    n = x.shape[0]
    starts = min(n, MOST_STARTS)
    anchors = x if n == starts else np.sort(x)
    trial = np.empty(n)
    best = -np.inf
    common = 0.0
    for j in range(starts):
        anchor = anchors[(2 * j + 1) * n // (2 * starts)]
        mean, bound = _one_start(x, anchor, variance, priors, sweeps, trial)
        if bound > best:
            best = bound
            common = mean
            r1[:] = trial
    return common
