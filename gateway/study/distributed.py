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
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.special import entr

from dbc.arrays import Array
from estimators.detect import paper, paper_vb
from estimators.detect.paper_vb import Moments, Params
from gateway.study.network import Consensus, Graph, Traffic, Tree, Wires


class Exchange(StrEnum):
    """How the nodes add up their sums."""

    TREE = "tree"
    CONSENSUS = "consensus"


class Result(NamedTuple):
    """Values in the nodes at the end.

    r1: (N,) E[I_i], each from its own node; m: (N, 2, 1) every node's copy of the component
    means; bound: (N, SWEEPS) every node's lower bound after each sweep.
    agreed: False if consensus gave up before it reached its tolerance.
    setup: traffic before the first sweep (tree and preset); sweeping: traffic of all sweeps.
    """

    r1: Array
    m: Array
    bound: Array
    agreed: bool
    setup: Traffic
    sweeping: Traffic


def pack(s: Moments, r: Array) -> Array:
    """Pack a node's message of 7 numbers: S0, S1, S2, and the entropy of its indicator."""
    return np.concatenate([s.S0.ravel(), s.S1.ravel(), s.S2.ravel(), [entr(r).sum()]])


def unpack(message: Array) -> tuple[Moments, Array]:
    """Inverse of `pack`: the moments, and the entropy (1,)."""
    S0, S1, S2 = message[:6].reshape(3, 1, 2)
    return Moments(S0, S1[..., None], S2[..., None, None]), message[6:]


def bound(s: Moments, entropy: Array, q: Params, prior: Params) -> Array:
    """The lower bound (T,) from the drives' sums instead of the drives themselves."""
    peak, Lambda = paper_vb.level(q)
    step = q.m - prior.m
    across = s.S1[..., :, None] * step[..., None, :]
    scatter = s.S2 - across - np.swapaxes(across, -1, -2)
    scatter = scatter + s.S0[..., None, None] * step[..., :, None] * step[..., None, :]
    drives = s.S0 * peak - 0.5 * np.einsum("tkij,tkji->tk", Lambda, scatter)
    return np.asarray(drives.sum(axis=-1) + entropy - paper_vb.divergence(q, prior))


def infer(x: Array, near: Graph, exchange: Exchange = Exchange.TREE) -> Result:
    """`paper_vb.infer` of one tick, loads x (N, 1) in Nm, over the network `near`.

    The nodes first agree on the largest load and use the paper's prior. Raises ValueError if the
    graph has another number of nodes.
    """
    n = len(x)
    if n != len(near):
        raise ValueError(f"{n} observations for {len(near)} nodes")
    wires = Wires(near)
    adder = Tree(wires) if exchange is Exchange.TREE else Consensus(wires)
    ends = adder.largest([np.array([v, -v]) for v in x[:, 0]])
    tops = [np.array([[high, -low]]) for high, low in ends]
    priors = [paper_vb.paper_prior(paper.preset_means(t)[0][..., None]) for t in tops]
    setup = wires.traffic()
    q, history, r1 = priors, [], np.empty(n)
    for _ in range(paper.SWEEPS):
        own = []
        for i in range(n):
            r = paper_vb.responsibilities(paper_vb.log_rho(x[None, i : i + 1], q[i]))
            r1[i] = r[0, 1, 0]
            own.append(pack(paper_vb.moments(x[None, i : i + 1], r, priors[i].m), r))
        sums = [unpack(message) for message in adder.total(own)]
        q = [paper_vb.update(p, total) for p, (total, _) in zip(priors, sums, strict=True)]
        each = zip(sums, q, priors, strict=True)
        history.append(np.concatenate([bound(s, h, f, p) for (s, h), f, p in each]))
    sweeping = Traffic(*(b - a for a, b in zip(setup, wires.traffic(), strict=True)))
    means = np.concatenate([f.m for f in q])
    return Result(r1, means, np.stack(history, axis=-1), adder.agreed, setup, sweeping)
