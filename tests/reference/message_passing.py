"""Message passing over whole records in NumPy: what `estimators/detect/message_passing.c` is
compared with, and the lower bound after each node."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.detect import paper
from estimators.detect.message_passing import ORDER, Node, Order, Priors, check
from estimators.detect.paper import Array, Arrays, Mask

INDICATORS_FIRST: Final[Order] = ("I", "pi", "mu", "Lambda")
"""As in the paper's VB: the loads are weighed against the presets before anything moves."""


class State(NamedTuple):
    """Natural parameters of the nodes.

    mu (T, 2, 2) for [mu, mu^2]; Lambda (T, 2, 2) for [log Lambda, Lambda]; pi (T, 2) for
    [log(1 - pi), log pi]; I (T, N) log odds of a lost drive.
    """

    mu: Array
    Lambda: Array
    pi: Array
    I: Array  # noqa: E741 - the paper's symbol


class Moments(NamedTuple):
    """Expectations that the nodes send out: see `moments`."""

    mu: Array
    var_mu: Array
    log_Lambda: Array
    Lambda: Array
    log_pi: Array
    I: Array  # noqa: E741


class Posterior(NamedTuple):
    """r1 = E[I] (T, N), m = E[mu] (T, 2), bound (T, S, 4) after each node, sweeps made (T,)."""

    r1: Array
    m: Array
    state: State
    bound: Array
    sweeps: NDArray[np.int64]

    @property
    def common(self) -> Array:
        """The global estimate M_z^(G) (T,): mean of the adhering component."""
        return self.m[:, 0]


def natural(priors: Priors, drives: int) -> State:
    """Priors as natural parameters; the indicators start even (pi = 0.5)."""
    return State(
        np.stack([priors.tau * priors.m, -0.5 * priors.tau], axis=-1),
        np.stack([priors.a - 1.0, -priors.b], axis=-1),
        priors.alpha - 1.0,
        np.zeros((len(priors.m), drives)),
    )


def moments(s: State) -> Moments:
    """What the nodes know: (49) for each family.

    The variance goes with the mean instead of E[mu^2], whose difference to (E mu)^2 is all
    rounding for a well-known mean.
    """
    from scipy.special import digamma, expit

    tau = -2.0 * s.mu[..., 1]
    a, b = s.Lambda[..., 0] + 1.0, -s.Lambda[..., 1]
    alpha = s.pi + 1.0
    return Moments(
        s.mu[..., 0] / tau,
        1.0 / tau,
        digamma(a) - np.log(b),
        a / b,
        digamma(alpha) - digamma(alpha.sum(axis=-1, keepdims=True)),
        expit(s.I),
    )


def distances(x: Array, e: Moments) -> Array:
    """E[(x_i - mu_k)^2] (T, 2, N)."""
    return np.asarray((x[:, None] - e.mu[..., None]) ** 2 + e.var_mu[..., None])


def x_to_I(x: Array, e: Moments) -> Array:
    """Message x_i -> I_i (T, 2, N): expected log density under each component."""
    level = 0.5 * (e.log_Lambda - math.log(2.0 * math.pi))
    return np.asarray(level[..., None] - 0.5 * e.Lambda[..., None] * distances(x, e))


def shares(e: Moments, weight: Array) -> Array:
    """[1 - E I, E I] (T, 2, N): scales the messages of (ii) and (v), and is I -> pi."""
    return np.stack([1.0 - e.I, e.I], axis=1) * weight[:, None]


def x_to_mu(x: Array, e: Moments, r: Array) -> Array:
    """(ii): sum over the drives of r [E Lambda x, -E Lambda / 2], (T, 2, 2)."""
    n = r.sum(axis=-1)
    return np.stack([e.Lambda * np.einsum("tkn,tn->tk", r, x), -0.5 * e.Lambda * n], axis=-1)


def x_to_Lambda(x: Array, e: Moments, r: Array) -> Array:
    """(v): sum over the drives of r [1/2, -E(x - mu)^2 / 2], (T, 2, 2)."""
    return 0.5 * np.stack([r.sum(axis=-1), -np.sum(r * distances(x, e), axis=-1)], axis=-1)


def pass_to(node: Node, x: Array, weight: Array, prior: State, s: State) -> State:
    """The state after `node` has taken its messages: (iii), (vi) and their missing twins."""
    e = moments(s)
    r = shares(e, weight)
    match node:
        case "I":
            odds = x_to_I(x, e) + e.log_pi[..., None]
            return s._replace(I=odds[:, 1] - odds[:, 0])
        case "pi":
            return s._replace(pi=prior.pi + r.sum(axis=-1))
        case "mu":
            return s._replace(mu=prior.mu + x_to_mu(x, e, r))
        case "Lambda":
            return s._replace(Lambda=prior.Lambda + x_to_Lambda(x, e, r))


def lower_bound(x: Array, weight: Array, prior: State, s: State) -> Array:
    """L (T,) of (51), corrected: E[log p(X, Z)] - E[log q(Z)]; valid after any update."""
    from scipy.special import betaln, entr, gammaln

    e = moments(s)
    r = shares(e, weight)
    odds = x_to_I(x, e) + e.log_pi[..., None]
    drives = np.sum(r * odds + entr(r), axis=(1, 2))
    alpha, alpha_prior = s.pi + 1.0, prior.pi + 1.0
    pi = (
        betaln(alpha_prior[:, 0], alpha_prior[:, 1])
        - betaln(alpha[:, 0], alpha[:, 1])
        + np.sum((alpha - alpha_prior) * e.log_pi, axis=-1)
    )
    tau, tau_prior = -2.0 * s.mu[..., 1], -2.0 * prior.mu[..., 1]
    step = e.mu - prior.mu[..., 0] / tau_prior
    mu = 0.5 * (np.log(tau / tau_prior) + tau_prior / tau - 1.0 + tau_prior * step**2)
    a, b = s.Lambda[..., 0] + 1.0, -s.Lambda[..., 1]
    a_prior, b_prior = prior.Lambda[..., 0] + 1.0, -prior.Lambda[..., 1]
    precision = (
        (a - a_prior) * e.log_Lambda
        - (b - b_prior) * e.Lambda
        + a * np.log(b)
        - gammaln(a)
        - a_prior * np.log(b_prior)
        + gammaln(a_prior)
    )
    return np.asarray(drives - pi - np.sum(mu + precision, axis=-1))


def infer(
    x: Array,
    priors: Priors,
    *,
    order: Order = ORDER,
    sweeps: int = paper.SWEEPS,
    tolerance: float | None = None,
    usable: Mask | None = None,
) -> Posterior:
    """Message passing at T ticks at once: x (T, N), usable (T, N), all where None.

    `tolerance` and `sweeps` as in `paper_vb.infer`. Drives that are not usable get r1 = 0.
    Raises ValueError for an order that does not name each node once.
    """
    check(order)
    weight = np.ones(x.shape) if usable is None else usable.astype(np.float64)
    x = np.where(weight > 0.0, x, 0.0)
    start = natural(priors, x.shape[1])

    def sweep(fixed: Arrays, state: Arrays) -> tuple[Arrays, Array]:
        x, weight, *prior_ = fixed
        prior, s = State(*prior_), State(*state)
        bounds = []
        for node in order:
            s = pass_to(node, x, weight, prior, s)
            bounds.append(lower_bound(x, weight, prior, s))
        return tuple(s), np.stack(bounds, axis=-1)

    run = paper.iterate(sweep, (x, weight, *start), tuple(start), sweeps, tolerance)
    s = State(*run.state)
    e = moments(s)
    return Posterior(e.I * weight, e.mu, s, run.bound, run.sweeps)
