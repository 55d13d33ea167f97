"""Variational message passing: paper `adhesion`, section 4.4, one observed quantity (D = 1).

Nodes mu_k (normal), Lambda_k (gamma), I_i (Bernoulli), pi (beta); all factors independent,
unlike VB's joint q(mu, Lambda). Steps (i)-(vi) are the paper's, corrected: the log density has
-1/2 log 2 pi; message (v) is [1/2, -((x - E mu)^2 + var mu) / 2]; the messages to and from I
and pi, missing in the paper, are

    x_i -> I_i   [E log p(x_i | mu_0, Lambda_0), E log p(x_i | mu_1, Lambda_1)]
    pi  -> I_i   [E log(1 - pi), E log pi]
    I_i -> pi    [1 - E I_i, E I_i]

The paper's "arbitrary order" does affect the result: a sweep updates each node once, in the
given `order`, and other orders end elsewhere. Of the 24 orders, `ORDER` comes nearest to the
paper's Table 1; docs/papers.md has the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np
from _traction_core import lib

from dbc.arrays import Array
from dbc.records import pointer
from estimators.detect import paper
from estimators.detect.protocol import Evidence, Opinion, nobody

Node = Literal["I", "pi", "mu", "Lambda"]
Order = tuple[Node, ...]

ORDER: Final[Order] = ("mu", "I", "pi", "Lambda")
"""Steps (i)-(iii), the missing messages to I and pi, then (iv)-(vi)."""

NODES: Final = {
    "I": lib.NODE_I, "pi": lib.NODE_PI, "mu": lib.NODE_MU, "Lambda": lib.NODE_LAMBDA,
}  # fmt: skip
"""The nodes as `message_passing.c` numbers them."""


class Priors(NamedTuple):
    """m (T, 2) preset means, tau (T, 2) their precisions, gamma a, b (T, 2), beta alpha (T, 2)."""

    m: Array
    tau: Array
    a: Array
    b: Array
    alpha: Array


def paper_priors(m: Array, tau: float = 0.01, a: float = 0.1, b: float = 0.1) -> Priors:
    """Section 5: means at the presets m (T, 2) with precision 0.01, gammas (0.1, 0.1), Beta(1, 1).

    The paper's "0.01" is read as the precision of the normals of the means.
    """
    one = np.ones_like(m)
    return Priors(m, tau * one, a * one, b * one, one)


def infer_tick(
    x: Array,
    priors: Priors,
    *,
    order: Order = ORDER,
    sweeps: int = paper.SWEEPS,
    tolerance: float | None = None,
) -> tuple[Array, Array, int]:
    """Infer one tick of x (N,) in `message_passing.c`: r1 = E[I] (N,), m = E[mu] (2,), sweeps made.

    priors: those of one tick, T = 1. With a `tolerance` the bound ends the sweeps, after at most
    `sweeps` of them. Raises ValueError for fewer than one sweep, or for an order that does not name
    each node once.
    """
    check(order)
    if sweeps < 1:
        raise ValueError("at least one sweep is needed")
    table = np.array([np.ravel(a) for a in priors], dtype=np.float64)
    load = np.ascontiguousarray(x, dtype=np.float64)
    q = np.empty_like(table)
    r1 = np.empty(len(load))
    made = lib.message_passing_infer(
        pointer("struct message_passing_factors", table), bytes(NODES[node] for node in order),
        sweeps, -1.0 if tolerance is None else tolerance, pointer("double", load), len(load),
        pointer("struct message_passing_factors", q), pointer("double", r1),
    )  # fmt: skip
    return r1, q[0], made


def check(order: Order) -> None:
    """Raise ValueError unless `order` names each of I, pi, mu, Lambda once."""
    if sorted(order) != sorted(ORDER):
        raise ValueError(f"a message order names each of {', '.join(ORDER)} once, not {order}")


def global_estimates(load: Array, order: Order = ORDER) -> Array:
    """M_z^(G) of the paper's VMP, five sweeps: loads (T, N) Nm -> (T,) Nm."""
    priors = paper_priors(paper.preset_means(load)[0])
    ticks = (Priors(*(values[t] for values in priors)) for t in range(len(load)))
    means = [infer_tick(x, prior, order=order)[1] for x, prior in zip(load, ticks, strict=True)]
    return np.array([m[0] for m in means])


@dataclass(frozen=True)
class MessagePassingDetector:
    """The paper's VMP as a detector. `lost` is E[I], with the two rules of `paper`.

    order, sweeps, tolerance: as in `infer_tick`; unit, carried: as in `PaperVariationalDetector`.
    """

    order: Order = ORDER
    sweeps: int = paper.SWEEPS
    tolerance: float | None = None
    unit: float = paper.UNIT_NM
    carried: float = 3.0

    code: ClassVar[int] = 2

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid order at the start, not later in the loop."""
        check(self.order)

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector."""
        part = paper.taking_part(evidence)
        if np.count_nonzero(part) < 2:
            return nobody(len(part))
        with np.errstate(all="ignore"):
            x = self.unit * evidence.load[part]
            r1, m, _ = infer_tick(
                x,
                paper_priors(paper.preset_means(x[None])[0]),
                order=self.order,
                sweeps=self.sweeps,
                tolerance=self.tolerance,
            )
            return paper.opinion(evidence, part, r1, float(m[0]) / self.unit, self.carried)
