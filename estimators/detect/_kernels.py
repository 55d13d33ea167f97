"""Compiled loops of the variational detector; `variational.infer` is the NumPy twin.

The batch is a handful of drives, so the array form spends its time in call overhead:
470 us against 5 us here for three drives.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import lean, njit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOST_STARTS = 16
"""Drives of the message set."""


Constants = tuple[float, float, float, float, float]


@lean
def digamma(x: float) -> float:
    """Digamma for x > 0: recurrence up to 10, then the asymptotic series (error < 1e-13)."""
    shift = 0.0
    while x < 10.0:
        shift -= 1.0 / x
        x += 1.0
    y = 1.0 / (x * x)
    series = y * (
        1.0 / 12.0 - y * (1.0 / 120.0 - y * (1.0 / 252.0 - y * (1.0 / 240.0 - y * (1.0 / 132.0))))
    )
    return shift + math.log(x) - 0.5 / x - series


@lean
def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


@lean
def _constants(priors: Array, n: int) -> Constants:
    """What is the same for every start.

    E[log pi] of both components before the first sweep, digamma of all counts, log gamma of the
    priors' shape, log beta of their counts.
    """
    alpha0, alpha1 = priors[3], priors[4]
    both = digamma(alpha0 + alpha1)
    return (
        digamma(alpha0) - both,
        digamma(alpha1) - both,
        digamma(alpha0 + alpha1 + n),
        math.lgamma(0.5 * priors[0]),
        _log_beta(alpha0, alpha1),
    )


@lean
def _one_start(
    x: Array, anchor: float, variance: float, priors: Array, constants: Constants, sweeps: int,
    r1: Array,
) -> tuple[float, float]:  # fmt: skip
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
    log_pi0, log_pi1, total, log_gamma, log_beta = constants
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
        log_pi0 = digamma(alpha0 + n0) - total
        log_pi1 = digamma(alpha1 + n1) - total
    bound = (
        entropy
        + math.lgamma(a0)
        - log_gamma
        + a * math.log(b[0])
        - a0 * math.log(b0)
        + 0.5 * math.log(beta[0] * v0)
        + math.lgamma(a1)
        - log_gamma
        + a * math.log(b[1])
        - a1 * math.log(b1)
        + 0.5 * math.log(beta[1] * v1)
        + _log_beta(alpha0 + n0, alpha1 + n1)
        - log_beta
        - 0.5 * n * math.log(2.0 * math.pi)
    )
    return m0, bound


@lean
def _usable(load: Array, spread: Array, usable: Flags, x: Array, lost: Array) -> tuple[int, float]:
    """Loads that may be compared, at the front of x; their number and mean variance."""
    m, variance = 0, 0.0
    for i in range(load.shape[0]):
        lost[i] = 0.0
        if usable[i]:
            x[m] = load[i]
            variance += spread[i] * spread[i]
            m += 1
    return m, variance / max(m, 1)


@lean
def _answer(
    usable: Flags, x: Array, r1: Array, variance: float, common: float, lost: Array
) -> None:
    """As much load as the others, or more, is not a lost wheel however odd it is."""
    least = math.sqrt(variance)
    sign = 1.0 if common >= 0.0 else -1.0
    k = 0
    for i in range(usable.shape[0]):
        if usable[i]:
            if (common - x[k]) * sign > least:
                lost[i] = r1[k]
            k += 1


@lean
def judge_few(
    load: Array, spread: Array, usable: Flags, priors: Array, sweeps: int, room: Array, lost: Array
) -> float:
    """`judge` of `MOST_STARTS` drives at most, in room (3, N)."""
    x, r1 = room[0], room[1]
    m, variance = _usable(load, spread, usable, x, lost)
    if m < 2:
        return 0.0
    common = _best_start(x[:m], x[:m], variance, priors, sweeps, room[2], r1)
    _answer(usable, x, r1, variance, common, lost)
    return common


@njit(cache=True, error_model="numpy")
def judge(
    load: Array, spread: Array, usable: Flags, priors: Array, sweeps: int, lost: Array
) -> float:
    """`VariationalDetector` on the usable drives; fills lost (N,), gives the common load."""
    x = np.empty(load.shape[0])
    m, variance = _usable(load, spread, usable, x, lost)
    if m < 2:
        return 0.0
    r1 = np.empty(m)
    common = best_start(x[:m], variance, priors, sweeps, r1)
    _answer(usable, x, r1, variance, common, lost)
    return common


@lean
def _best_start(
    x: Array, anchors: Array, variance: float, priors: Array, sweeps: int, trial: Array, r1: Array
) -> float:
    """See `best_start`; anchors (N,): x, in ascending order if they are many; trial (N,): room."""
    n = x.shape[0]
    starts = min(n, MOST_STARTS)
    constants = _constants(priors, n)
    best, common = -np.inf, 0.0
    for j in range(starts):
        anchor = anchors[(2 * j + 1) * n // (2 * starts)]
        mean, bound = _one_start(x, anchor, variance, priors, constants, sweeps, trial)
        if bound > best:
            best = bound
            common = mean
            for i in range(n):
                r1[i] = trial[i]
    return common


@njit(cache=True, error_model="numpy")
def best_start(x: Array, variance: float, priors: Array, sweeps: int, r1: Array) -> float:
    """Start at every load in turn; keep the highest lower bound.

    x (N,), priors = (nu, beta_adhering, beta_lost, alpha_adhering, alpha_lost); fills r1 (N,)
    with E[I] and gives the mean of the adhering component. Ties keep the first start. Of more than
    `MOST_STARTS` loads so many, evenly by rank: the cost per drive stays what it is.
    """
    anchors = x if x.shape[0] <= MOST_STARTS else np.sort(x)
    return _best_start(x, anchors, variance, priors, sweeps, np.empty(x.shape[0]), r1)
