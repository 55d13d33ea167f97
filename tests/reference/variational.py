"""Variational Bayes in NumPy, for all starts at once: `estimators/detect/variational.c` to compare.

Paper `adhesion`, section 4.2; the equations' numbers are the paper's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray
from scipy.special import betaln, digamma, expit, gammaln

from estimators.detect.variational import Priors

Array = NDArray[np.float64]
VB_MAX_STARTS = lib.VB_MAX_STARTS


class Posterior(NamedTuple):
    """Result for S starts and N drives: r1 = E[I] (S, N), m (S, 2), bound (S,)."""

    r1: Array
    m: Array
    bound: Array


def infer(x: Array, m: Array, scatter: Array, priors: Priors, sweeps: int = 5) -> Posterior:
    """Run the variational sweeps for every start at once.

    x: (N,) loads; m: (S, 2) prior means; scatter: (S, 2) prior variances 1/E[Lambda].
    Each sweep is (32)-(35), then (39)-(47), so the bound never falls from sweep to sweep.
    """
    beta = np.array([priors.beta_adhering, priors.beta_lost])
    alpha = np.array([priors.alpha_adhering, priors.alpha_lost])
    a = np.full_like(scatter, priors.nu / 2.0)
    b = a * scatter
    n = x.shape[0]
    # Before the first sweep the factors are the priors, each mean exactly at its start.
    e_log_pi = np.broadcast_to(digamma(alpha) - digamma(alpha.sum()), m.shape)
    m_k, a_k, b_k, beta_k = m, a, b, np.full_like(m, np.inf)
    r1 = bound = np.empty(0)
    for _ in range(sweeps):
        # (32), (33), (46), (47): expected log density of x_i under component k.
        e_log_lambda = digamma(a_k) - np.log(b_k)
        e_square = 1.0 / beta_k[..., None] + (a_k / b_k)[..., None] * (x - m_k[..., None]) ** 2
        log_rho = (e_log_pi + 0.5 * e_log_lambda)[..., None] - 0.5 * e_square
        # (35)
        r1 = expit(log_rho[:, 1] - log_rho[:, 0])
        r = np.stack([1.0 - r1, r1], axis=1)
        # (43), (44); N_k -> 0 leaves the prior as it is.
        n_k = r.sum(axis=-1)
        x_bar = np.divide(r @ x, n_k, out=m.copy(), where=n_k > 1e-12)
        n_s = np.sum(r * (x - x_bar[..., None]) ** 2, axis=-1)
        # (39)-(42)
        beta_k = beta + n_k
        m_k = (beta * m + n_k * x_bar) / beta_k
        a_k = a + 0.5 * n_k
        b_k = b + 0.5 * (n_s + beta * n_k * (x_bar - m) ** 2 / beta_k)
        # (45), with the missing twin for 1 - pi.
        alpha_k = alpha + n_k
        e_log_pi = digamma(alpha_k) - digamma(alpha_k.sum(axis=-1, keepdims=True))
        bound = _bound(r, alpha, alpha_k, (a, b, beta), (a_k, b_k, beta_k), n)
    return Posterior(r1, m_k, bound)


def _bound(
    r: Array,
    alpha: Array,
    alpha_k: Array,
    prior: tuple[Array, Array, Array],
    posterior: tuple[Array, Array, Array],
    n: int,
) -> Array:
    """Lower bound (18) right after the parameter update: ratios of normalising constants."""
    (a, b, beta), (a_k, b_k, beta_k) = prior, posterior
    entropy = -np.sum(r * np.log(np.maximum(r, 1e-300)), axis=(1, 2))
    components = (
        gammaln(a_k) - gammaln(a) + a * np.log(b) - a_k * np.log(b_k) + 0.5 * np.log(beta / beta_k)
    ).sum(axis=-1)
    weights = betaln(alpha_k[:, 0], alpha_k[:, 1]) - betaln(alpha[0], alpha[1])
    return np.asarray(entropy + components + weights - 0.5 * n * np.log(2.0 * np.pi))


def starts(x: Array, variance: float) -> tuple[Array, Array]:
    """Prior means (S, 2) and variances (S, 2) of S starts, one at each load.

    Of more than `VB_MAX_STARTS` loads so many, evenly by rank. A lost load lies anywhere in [0, m]:
    mean m/2, variance m^2/12.
    """
    if len(x) > VB_MAX_STARTS:
        x = np.sort(x)[(2 * np.arange(VB_MAX_STARTS) + 1) * len(x) // (2 * VB_MAX_STARTS)]
    means = np.stack([x, 0.5 * x], axis=1)
    scatter = np.stack([np.full(x.shape, variance), variance + x * x / 12.0], axis=1)
    return means, scatter
