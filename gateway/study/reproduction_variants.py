"""What paper `adhesion` mentions beside Table 1: variants of VB, and VB without a central unit.

The variants: bound, reuse, two observed quantities. The other is the outlook (section 6), on the
loads of section 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.detect import paper, paper_vb
from gateway.study import distributed
from gateway.study.distributed import Exchange
from gateway.study.network import Graph, ring, tree
from gateway.study.reproduction import STATISTICS, statistics
from gateway.study.reproduction_text import grid, number

BOUND_TOLERANCE: Final = 1e-6
PHI: Final = 0.5
INSTANTS: Final = 4
"""Number of instants, spread over the record."""
NEIGHBOURS: Final = 5
"""Number of adjacent samples: with three drives they make the loads of fifteen nodes."""


class Variant(NamedTuple):
    """Variant of the paper's VB. value (3, 8): STATISTICS per drive, Nm; sweeps: mean of ticks."""

    name: str
    value: Array
    sweeps: float


def variants(load: Array, speed: Array) -> list[Variant]:
    """Results of VB as in Table 1, and of the variants that the paper mentions.

    load (T, N) Nm, speed (T, N) rad/s electrical. D = 2 observes both; `reuse` is section 5's
    flattened posterior (`paper_vb.flatten`, phi PHI); the bound (18) as the stopping rule ends the
    sweeps once it grows by less than BOUND_TOLERANCE.
    """
    x, preset = paper.observations(load, None, paper.Observe.TORQUE)
    prior = paper_vb.paper_prior(preset)
    both, preset_2 = paper.observations(load, speed, paper.Observe.BOTH)
    found = {
        f"D = 1, {paper.SWEEPS} sweeps (Table 1)": paper_vb.infer(x, prior),
        f"stopped by the bound ({BOUND_TOLERANCE:g})": paper_vb.infer(
            x, prior, sweeps=paper.MOST_SWEEPS, tolerance=BOUND_TOLERANCE
        ),
        "reuse": paper_vb.infer_reusing(x, prior, PHI),
        "D = 2, load and speed": paper_vb.infer(both, paper_vb.paper_prior(preset_2)),
    }
    return [
        Variant(
            name, np.array([statistics(one) for one in (load - q.common[:, None]).T]),
            float(np.mean(q.sweeps)),
        )
        for name, q in found.items()
    ]  # fmt: skip


def section(found: list[Variant]) -> list[str]:
    """Section of the report."""
    rows = [
        [one.name, f"PMSM{drive}", *(number(v) for v in values), number(one.sweeps, 1)]
        for one in found
        for drive, values in enumerate(one.value.tolist(), 1)
    ]
    return [
        "## Variants of VB",
        "What the paper mentions without a table of it: more sweeps until the bound (18) stands, "
        "the flattened posterior of the last instant as the next prior (section 5), load and speed "
        'observed together (D = 2, priors of section 5). `[adhesion] detector = "paper_vb"` has '
        "them as `tolerance`, `reuse` and `observe`.",
        grid(("VB", "drive", *STATISTICS, "sweeps"), rows),
    ]


class NetworkRow(NamedTuple):
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


def networks_of(load: Array) -> list[NetworkRow]:
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


def _row(name: str, near: Graph, exchange: Exchange, x: Array) -> NetworkRow:
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
    return NetworkRow(name, exchange.value, len(near), apart, messages / len(x), rounds / len(x))


def network_section(found: Sequence[NetworkRow]) -> list[str]:
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
