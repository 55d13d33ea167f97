"""The paper's variational Bayes with the paper's priors: `adhesion`, section 4.2, (21)-(47).

Two normal-Wishart components and a beta weight over N drives, D = 1 (load or speed) or D = 2
(both). Corrected where misprinted: (27)-(28) one m per component; (36), (43), (44) weights
1 - E[I] for component 0 and E[I] for component 1; (45) with its twin
E[log(1 - pi)] = psi(alpha_0) - psi(alpha_0 + alpha_1); (18) L = integral q log(f(X, Z) / q).

Moments are taken about the prior mean, d = x - m, which turns (39)-(44) into

    beta+ = beta + S0,   m+ = m + S1 / beta+,   W_inv+ = W_inv + S2 - S1 S1' / beta+

with S0, S1, S2 = sums of r, r d, r d d'. Nothing is divided by N_k, so an empty component
(N_k -> 0) stays at its prior without a guard. In a distributed version the drives would have to
exchange nothing but these sums.

This is the reference for the product's `variational`, which is better: with W = 100 the paper's
E[I] does not detect a partial loss (docs/papers.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.records import pointer
from estimators.detect import paper
from estimators.detect.paper import Arrays, Observe
from estimators.detect.protocol import Evidence, Opinion, nobody


class Params(NamedTuple):
    """Parameters of q(mu, Lambda) q(pi), or the prior of the same form, for T ticks.

    m (T, 2, D), beta (T, 2), W_inv (T, 2, D, D) the inverse of the paper's W, nu (T, 2),
    alpha (T, 2). Component 0 adheres.
    """

    m: Array
    beta: Array
    W_inv: Array
    nu: Array
    alpha: Array


class Moments(NamedTuple):
    """Weighted sums over the drives about the prior means: S0 (T, 2), S1 (T, 2, D), S2 (.., D)."""

    S0: Array
    S1: Array
    S2: Array


class Posterior(NamedTuple):
    """r1 = E[I] (T, N), the factors, bound (T, S, 2) and the sweeps made (T,).

    bound[..., 0] follows the update of q(I), bound[..., 1] that of q(pi, mu, Lambda).
    """

    r1: Array
    q: Params
    bound: Array
    sweeps: NDArray[np.int64]

    @property
    def common(self) -> Array:
        """The global estimate M_z^(G) (T,): mean of the adhering component, first quantity."""
        return self.q.m[:, 0, 0]


def paper_prior(m: Array, W: float = 100.0, nu: float = 3.0, beta: float = 1.0) -> Params:
    """Section 5's priors at the preset means m (T, 2, D): nu 3, W 100, alpha = beta = 1.

    W is 100 in each of the D quantities (1/Nm^2, s^2/rad^2) and zero across them.
    """
    T, _, D = m.shape
    pair = np.ones((T, 2))
    W_inv = np.broadcast_to(np.eye(D) / W, (T, 2, D, D))
    return Params(m, beta * pair, W_inv, nu * pair, pair)


def invert(A: Array) -> tuple[Array, Array]:
    """Inverse and log determinant of positive definite (.., D, D), D = 1 or 2.

    The closed form never raises on numbers. Raises ValueError for other D.
    """
    if A.shape[-1] == 1:
        return 1.0 / A, np.log(A[..., 0, 0])
    if A.shape[-1] != 2:
        raise ValueError(f"one or two observed quantities, not {A.shape[-1]}")
    a, b, c = A[..., 0, 0], A[..., 0, 1], A[..., 1, 1]
    schur = c - b * (b / a)
    det = a * schur
    inverse = np.stack([np.stack([c, -b], -1), np.stack([-b, a], -1)], -2) / det[..., None, None]
    return inverse, np.log(a) + np.log(schur)


def expected_log_det(q: Params, log_det_W_inv: Array) -> Array:
    """(46): E[log det Lambda_k] (T, 2)."""
    from scipy.special import digamma

    D = q.m.shape[-1]
    psi = digamma(halves(q.nu, D)).sum(axis=-1)
    return np.asarray(psi + D * math.log(2.0) - log_det_W_inv)


def halves(nu: Array, D: int) -> Array:
    """(nu + 1 - d) / 2 for d = 1..D along a new last axis."""
    return np.asarray(0.5 * (nu[..., None] - np.arange(D)))


def level(q: Params) -> tuple[Array, Array]:
    """Peak of log rho (T, 2), at each component's mean, and E[Lambda] = nu W (T, 2, D, D)."""
    from scipy.special import digamma

    D = q.m.shape[-1]
    W, log_det = invert(q.W_inv)
    e_log_pi = digamma(q.alpha) - digamma(q.alpha.sum(axis=-1, keepdims=True))
    e_log_det = expected_log_det(q, log_det)
    peak = e_log_pi + 0.5 * (e_log_det - D * math.log(2.0 * math.pi) - D / q.beta)
    return peak, q.nu[..., None, None] * W


def log_rho(x: Array, q: Params) -> Array:
    """(32), (33) with (45)-(47): log rho_k,i (T, 2, N) of x (T, N, D)."""
    peak, Lambda = level(q)
    d = x[:, None] - q.m[:, :, None]
    square = np.einsum("tkni,tkij,tknj->tkn", d, Lambda, d)
    return np.asarray(peak[..., None] - 0.5 * square)


def responsibilities(rho: Array) -> Array:
    """(35): [1 - E[I], E[I]] as (T, 2, N)."""
    from scipy.special import expit

    z = rho[:, 1] - rho[:, 0]
    return np.stack([expit(-z), expit(z)], axis=1)


def moments(x: Array, r: Array, m: Array) -> Moments:
    """Sums (43), (44) over the drives, taken about the prior means m (T, 2, D)."""
    d = x[:, None] - m[:, :, None]
    rd = r[..., None] * d
    return Moments(r.sum(axis=-1), rd.sum(axis=-2), np.einsum("tkni,tknj->tkij", rd, d))


def update(prior: Params, s: Moments) -> Params:
    """(37)-(42): the factors that follow from the drives' sums."""
    beta = prior.beta + s.S0
    step = s.S1 / beta[..., None]
    return Params(
        prior.m + step,
        beta,
        prior.W_inv + s.S2 - s.S1[..., :, None] * step[..., None, :],
        prior.nu + s.S0,
        prior.alpha + s.S0,
    )


def drives_part(r: Array, rho: Array) -> Array:
    """Contribution of the drives to the bound (T,): sum of r (log rho - log r)."""
    from scipy.special import entr

    return np.asarray(np.sum(r * rho + entr(r), axis=(1, 2)))


def divergence(q: Params, prior: Params) -> Array:
    """KL divergence (T,) of q(pi) q(mu, Lambda) from the prior, which reduces the bound.

    It is infinite for a mean that is known exactly (beta infinite).
    """
    from scipy.special import betaln, digamma, gammaln

    D = q.m.shape[-1]
    e_log_pi = digamma(q.alpha) - digamma(q.alpha.sum(axis=-1, keepdims=True))
    weight = (
        betaln(prior.alpha[:, 0], prior.alpha[:, 1])
        - betaln(q.alpha[:, 0], q.alpha[:, 1])
        + np.sum((q.alpha - prior.alpha) * e_log_pi, axis=-1)
    )
    W, log_det_inv = invert(q.W_inv)
    log_det_inv_prior = invert(prior.W_inv)[1]
    step = q.m - prior.m
    mean = 0.5 * (
        D * (np.log(q.beta / prior.beta) + prior.beta / q.beta - 1.0)
        + prior.beta * q.nu * np.einsum("tki,tkij,tkj->tk", step, W, step)
    )
    precision = (
        0.5 * (q.nu - prior.nu) * (expected_log_det(q, log_det_inv) - D * math.log(2.0))
        + 0.5 * q.nu * (np.einsum("tkij,tkji->tk", prior.W_inv, W) - D)
        + 0.5 * (q.nu * log_det_inv - prior.nu * log_det_inv_prior)
        + np.sum(gammaln(halves(prior.nu, D)) - gammaln(halves(q.nu, D)), axis=-1)
    )
    return np.asarray(weight + np.sum(mean + precision, axis=-1))


def _sweep(fixed: Arrays, state: Arrays) -> tuple[Arrays, Array]:
    """Update q(I), then q(pi, mu, Lambda); the bound after each. See `paper.iterate`."""
    x, *prior_ = fixed
    rho, _, *q_ = state
    prior, q = Params(*prior_), Params(*q_)
    r = responsibilities(rho)
    indicated = drives_part(r, rho) - divergence(q, prior)
    q = update(prior, moments(x, r, prior.m))
    rho = log_rho(x, q)
    updated = drives_part(r, rho) - divergence(q, prior)
    return (rho, r[:, 1], *q), np.stack([indicated, updated], axis=-1)


def infer(
    x: Array,
    prior: Params,
    *,
    sweeps: int = paper.SWEEPS,
    tolerance: float | None = None,
) -> Posterior:
    """Variational Bayes at T ticks at once: x (T, N, D).

    Each sweep is (32)-(35), then (37)-(47). The factors start as the prior (the paper's preset
    means). With a `tolerance` the bound ends the sweeps (`paper.iterate`), after at most `sweeps`
    of them. Raises ValueError if D is neither 1 nor 2, and for fewer than one sweep.
    """
    start = log_rho(x, prior), np.zeros(x.shape[:2]), *prior
    run = paper.iterate(_sweep, (x, *prior), start, sweeps, tolerance)
    return Posterior(run.state[1], Params(*run.state[2:]), run.bound, run.sweeps)


def infer_tick(
    x: Array,
    prior: Params,
    *,
    sweeps: int = paper.SWEEPS,
    tolerance: float | None = None,
) -> Posterior:
    """`infer` for a single tick, x (1, N, D); with D = 1 it runs in `paper_vb.c`."""
    if x.shape[-1] != 1:
        return infer(x, prior, sweeps=sweeps, tolerance=tolerance)
    if sweeps < 1:
        raise ValueError("at least one sweep is needed")
    table = np.array([np.ravel(a) for a in prior], dtype=np.float64)
    load = np.ascontiguousarray(x[0, :, 0], dtype=np.float64)
    q = np.empty_like(table)
    r1 = np.empty(len(load))
    bound = np.empty((sweeps, 2))
    made = lib.paper_vb_infer(
        pointer("struct paper_vb_factors", table), sweeps, -1.0 if tolerance is None else tolerance,
        pointer("double", load), len(load), pointer("struct paper_vb_factors", q),
        pointer("double", r1), pointer("struct paper_vb_bound", bound),
    )  # fmt: skip
    m, beta, W_inv, nu, alpha = q[:, None]
    found = Params(m[..., None], beta, W_inv[..., None, None], nu, alpha)
    return Posterior(r1[None], found, bound[None], np.array([made]))


def flatten(q: Params, preset: Params, phi: float) -> Params:
    """Prior of the next tick from this tick's posterior: q^phi preset^(1 - phi), normalised.

    Section 5 of the paper concludes with a "flattened posterior" but gives no formula. Ours is
    exponential forgetting towards the preset, linear in the natural parameters: phi = 0 gives the
    preset itself, phi = 1 forgets nothing.
    """
    beta = phi * q.beta + (1.0 - phi) * preset.beta
    share = phi * q.beta / beta
    step = q.m - preset.m
    across = (share * (1.0 - phi) * preset.beta)[..., None, None]
    return Params(
        preset.m + share[..., None] * step,
        beta,
        phi * q.W_inv
        + (1.0 - phi) * preset.W_inv
        + across * step[..., :, None] * step[..., None, :],
        phi * q.nu + (1.0 - phi) * preset.nu,
        phi * q.alpha + (1.0 - phi) * preset.alpha,
    )


def infer_reusing(x: Array, preset: Params, phi: float) -> Posterior:
    """`infer` tick after tick, each prior flattened from the tick before; shapes as `infer`.

    Sequential: T ticks are T calls.
    """
    parts = []
    last: Params | None = None
    for t in range(len(x)):
        now = Params(*(a[t : t + 1] for a in preset))
        prior = now if last is None else flatten(last, now, phi)
        part = infer_tick(x[t : t + 1], prior)
        last = part.q
        parts.append(part)
    return Posterior(
        np.concatenate([p.r1 for p in parts]),
        Params(*(np.concatenate(a) for a in zip(*(p.q for p in parts), strict=True))),
        np.concatenate([p.bound for p in parts]),
        np.concatenate([p.sweeps for p in parts]),
    )


def global_estimates(load: Array) -> Array:
    """M_z^(G) of the paper's VB, five sweeps: loads (T, N) Nm -> (T,) Nm."""
    x, m = paper.observations(load, None, Observe.TORQUE)
    return infer(x, paper_prior(m)).common


@dataclass(frozen=True)
class PaperVariationalDetector:
    """The paper's VB as a detector. `lost` is E[I], with the two rules of `paper`.

    sweeps, tolerance: as in `infer`. unit: Nm per unit of the evidence's load (30: per unit of
    the paper's rated torque; 1: Nm), because the priors are in Nm. carried: see `paper`.
    """

    sweeps: int = paper.SWEEPS
    tolerance: float | None = None
    observe: Observe = Observe.TORQUE
    unit: float = paper.UNIT_NM
    carried: float = 3.0

    code: ClassVar[int] = 1

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. Without a speed that it has to observe, all drives are unknown."""
        part = paper.taking_part(evidence, self.observe)
        if np.count_nonzero(part) < 2:
            return nobody(len(part))
        load = self.unit * evidence.load[part]
        speed = evidence.speed[part][None] if evidence.speed is not None else None
        with np.errstate(all="ignore"):
            x, m = paper.observations(load[None], speed, self.observe)
            prior = self._prior(paper_prior(m))
            found = infer_tick(x, prior, sweeps=self.sweeps, tolerance=self.tolerance)
            self._remember(found.q)
            lost = found.r1[0]
            common = found.common[0]
            if self.observe is Observe.SPEED:
                common = np.average(load, weights=1.0 - lost + 1e-12)
            return paper.opinion(evidence, part, lost, float(common) / self.unit, self.carried)

    def _prior(self, preset: Params) -> Params:
        return preset

    def _remember(self, q: Params) -> None:
        """Do nothing: this detector has no memory."""


@dataclass(frozen=True)
class ReusingVariationalDetector(PaperVariationalDetector):
    """The paper's VB with the flattened posterior of the last call as the next prior.

    Unlike the paper's other detectors it has a memory, so one object serves one sequence of
    ticks. phi: see `flatten`; the paper gives no value, ours is 0.5. A posterior that is not
    finite is not kept.
    """

    phi: float = 0.5

    _last: list[Params] = field(default_factory=list, init=False, repr=False, compare=False)

    def _prior(self, preset: Params) -> Params:
        return flatten(self._last[0], preset, self.phi) if self._last else preset

    def _remember(self, q: Params) -> None:
        if all(np.isfinite(a).all() for a in q):
            self._last[:] = [q]
