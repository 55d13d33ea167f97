"""Distributed variational Bayes: the outlook of paper `adhesion`, section 6.

Each drive's node holds only its own observation and exchanges messages with its neighbours. The
sweep (32)-(47) of `paper_vb` needs only sums over the drives from them: S0, S1, S2 of the
moments (sums of r, r d, r d d' with d = x - m), and for the bound the entropy. The nodes add
these up together, and each then updates q(pi, mu, Lambda) for itself; q(I_i) never leaves
node i. No Hamiltonian cycle is needed, only a connected graph. There are two ways to add up:

- `TREE`: a flood from node 0 leaves a spanning tree (each node's parent is the first sender it
  received, the lowest number among equals); sums go to the root and the total comes back, 2 (N - 1)
  messages a sweep. Exact: all nodes hold the same bits.
- `CONSENSUS`: no root and no tree; Metropolis-weighted averaging with all neighbours, 2 E
  messages a round (E edges), until maximum and minimum over the nodes agree. Both are flooded
  along, so all nodes stop in the same round. Each node knows N.

The product's priors (`variational`) can be used as `prior` and `start`; but its starts at every
drive's load would send every load to all nodes, and then each node could compute everything itself.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from estimators.detect import paper, paper_vb
from estimators.detect.paper import Array
from estimators.detect.paper_vb import Moments, Params
from gateway.study.network import Consensus, Graph, Traffic, Tree, Wires


class Exchange(StrEnum):
    """How the nodes add up their sums."""

    TREE = "tree"
    CONSENSUS = "consensus"


class Result(NamedTuple):
    """Values in the nodes at the end.

    r1: (N,) E[I_i], each from its own node; m: (N, 2, D) every node's copy of the component
    means; bound: (N, S) every node's lower bound after each sweep; sweeps: their number S.
    agreed: False if consensus gave up before it reached its tolerance.
    setup: traffic before the first sweep (tree and preset); sweeping: traffic of all sweeps.
    """

    r1: Array
    m: Array
    bound: Array
    sweeps: int
    agreed: bool
    setup: Traffic
    sweeping: Traffic


def pack(s: Moments, entropy: Array) -> Array:
    """Pack a node's message: S0, S1, upper triangles of S2, entropy; 7 numbers (D = 2: 13)."""
    upper = np.triu_indices(s.S1.shape[-1])
    return np.concatenate([s.S0.ravel(), s.S1.ravel(), s.S2[0][:, *upper].ravel(), entropy])


def unpack(message: Array, D: int) -> tuple[Moments, Array]:
    """Inverse of `pack`, with T = 1."""
    rows, columns = np.triu_indices(D)
    S2 = np.empty((1, 2, D, D))
    S2[0][:, rows, columns] = S2[0][:, columns, rows] = message[2 + 2 * D : -1].reshape(2, -1)
    return Moments(message[None, :2], message[2 : 2 + 2 * D].reshape(1, 2, D), S2), message[-1:]


def bound(s: Moments, entropy: Array, q: Params, prior: Params) -> Array:
    """The lower bound (T,) from the drives' sums instead of the drives themselves."""
    peak, Lambda = paper_vb.level(q)
    step = q.m - prior.m
    across = s.S1[..., :, None] * step[..., None, :]
    scatter = s.S2 - across - np.swapaxes(across, -1, -2)
    scatter = scatter + s.S0[..., None, None] * step[..., :, None] * step[..., None, :]
    drives = s.S0 * peak - 0.5 * np.einsum("tkij,tkji->tk", Lambda, scatter)
    return np.asarray(drives.sum(axis=-1) + entropy - paper_vb.divergence(q, prior))


def infer(
    x: Array,
    near: Graph,
    *,
    prior: Params | None = None,
    start: Params | None = None,
    sweeps: int = paper.SWEEPS,
    tolerance: float | None = None,
    exchange: Exchange = Exchange.TREE,
) -> Result:
    """`paper_vb.infer` of one tick, x (N, D), over the network `near`.

    prior, start: known to all nodes (T = 1); without a prior, the nodes first agree on the largest
    load and use the paper's prior (D = 1). tolerance: stop by the bound as `paper_vb.infer` does;
    consensus then floods the decision too, because the nodes' copies differ in the last digits.
    Raises ValueError if D = 2 has no prior or the graph has another number of nodes.
    """
    n, D = x.shape
    if n != len(near):
        raise ValueError(f"{n} observations for {len(near)} nodes")
    wires = Wires(near)
    adder = Tree(wires) if exchange is Exchange.TREE else Consensus(wires)
    if prior is None:
        if D != 1:
            raise ValueError("two observed quantities need a prior that the nodes know")
        ends = adder.largest([np.array([v, -v]) for v in x[:, 0]])
        tops = [np.array([[high, -low]]) for high, low in ends]
        priors = [paper_vb.paper_prior(paper.preset_means(t)[0][..., None]) for t in tops]
    else:
        priors = [prior] * n
    setup = wires.traffic()
    q = priors if start is None else [start] * n
    history: list[Array] = []
    before = np.full(n, -np.inf)
    r1 = np.empty(n)
    for s in range(sweeps):
        own = []
        for i in range(n):
            r = paper_vb.responsibilities(paper_vb.log_rho(x[None, i : i + 1], q[i]))
            r1[i] = r[0, 1, 0]
            own.append(pack(paper_vb.moments(x[None, i : i + 1], r, priors[i].m), entropy(r)))
        sums = [unpack(message, D) for message in adder.total(own)]
        if s == 0:
            before = _bounds(sums, q, priors)
        q = [paper_vb.update(p, total) for p, (total, _) in zip(priors, sums, strict=True)]
        after = _bounds(sums, q, priors)
        history.append(after)
        if tolerance is not None:
            more = after - before - tolerance * np.abs(after)
            if exchange is Exchange.CONSENSUS:
                more = np.concatenate(adder.largest(list(more[:, None])))
            if not (more >= 0.0).all():
                break
        before = after
    end = wires.traffic()
    return Result(
        r1,
        np.concatenate([f.m for f in q]),
        np.stack(history, axis=-1),
        len(history),
        adder.agreed,
        setup,
        Traffic(*(b - a for a, b in zip(setup, end, strict=True))),
    )


def entropy(r: Array) -> Array:
    """Entropy (T,) of the indicators."""
    from scipy.special import entr

    return np.asarray(entr(r).sum(axis=(1, 2)))


def _bounds(sums: list[tuple[Moments, Array]], q: list[Params], priors: list[Params]) -> Array:
    """Each node's own lower bound (N,)."""
    each = zip(sums, q, priors, strict=True)
    return np.concatenate([bound(s, h, f, p) for (s, h), f, p in each])
