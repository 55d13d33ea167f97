"""VB without a central unit (outlook of paper `adhesion`, section 6), on the loads of section 5."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.detect import paper, paper_vb
from gateway.study import distributed
from gateway.study.distributed import Exchange
from gateway.study.network import Graph, ring, tree
from gateway.study.reproduction_text import grid

Array = NDArray[np.float64]
INSTANTS: Final = 4
"""Number of instants, spread over the record."""
NEIGHBOURS: Final = 5
"""Number of adjacent samples: with three drives they make the loads of fifteen nodes."""


class Row(NamedTuple):
    """Results of one network: means over the instants, except `apart`, which is a maximum.

    apart: largest difference from the central unit, of E[I] or of the component means in Nm;
    messages, rounds: per instant, with the agreement on the prior.
    """

    network: str
    exchange: str
    nodes: int
    apart: float
    messages: float
    rounds: float


def rows(load: Array) -> list[Row]:
    """Results of rings and trees on loads (T, N) in Nm, with five sweeps as in the paper."""
    first = np.linspace(0, len(load) - NEIGHBOURS, INSTANTS).astype(int)
    few = load[first]
    many = np.stack([load[first + k] for k in range(NEIGHBOURS)], axis=1).reshape(INSTANTS, -1)
    found = []
    for x in (few, many):
        n = x.shape[1]
        networks: list[tuple[str, Graph]] = [("ring", ring(n)), ("tree", tree(n))]
        for name, near in networks:
            found += [_row(name, near, exchange, x) for exchange in Exchange]
    return found


def _row(name: str, near: Graph, exchange: Exchange, x: Array) -> Row:
    apart, messages, rounds = 0.0, 0, 0
    for loads in x:
        got = distributed.infer(loads[:, None], near, exchange=exchange)
        seen, means = paper.observations(loads[None], None, paper.Observe.TORQUE)
        want = paper_vb.infer(seen, paper_vb.paper_prior(means))
        apart = max(
            apart,
            float(np.abs(got.r1 - want.r1[0]).max()),
            float(np.abs(got.m - want.q.m[0]).max()),
        )
        messages += got.setup.messages + got.sweeping.messages
        rounds += got.setup.rounds + got.sweeping.rounds
    return Row(name, exchange.value, len(near), apart, messages / len(x), rounds / len(x))


def section(found: Sequence[Row]) -> list[str]:
    """Section of the report on these networks."""
    text = [
        [r.network, r.exchange, str(r.nodes), f"{r.apart:.0e}", f"{r.messages:.0f}",
         f"{r.rounds:.0f}"]
        for r in found
    ]  # fmt: skip
    return [
        "## Without a central unit",
        f"The outlook of section 6 at {INSTANTS} instants of the loads above: every drive's node "
        "knows its own load only and adds up sufficient statistics with its neighbours, over a "
        "spanning tree that a flood finds, or by averaging until all agree. No Hamiltonian cycle "
        "is needed. Fifteen nodes are the three drives at five samples next to one another. "
        "Apart: largest difference of E[I], and of the means in Nm, from the central unit.",
        grid(("network", "adding up", "nodes", "apart", "messages", "rounds"), text),
    ]
