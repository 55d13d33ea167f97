"""Distributed variational Bayes: the nodes end where the central unit ends, and what it costs."""

import numpy as np
import pytest

from estimators.detect import paper, paper_vb
from gateway.study import distributed
from gateway.study.distributed import Exchange
from gateway.study.network import Consensus, Tree, Wires, graph, ring, tree

BOTH = pytest.mark.parametrize("exchange", list(Exchange))
FLOATS = 7
"""Numbers in a node's message: S0, S1, S2, entropy."""


def loads(seed, drives):
    rng = np.random.default_rng(seed)
    x = 20 + rng.normal(0, 0.4, (drives, 1))
    x[rng.random(drives) < 0.3] *= rng.uniform(0, 0.8)
    return x


def random_graph(seed, nodes):
    """A random tree and a few more edges."""
    rng = np.random.default_rng(seed)
    name = rng.permutation(nodes)
    edges = [(name[i], name[rng.integers(i)]) for i in range(1, nodes)]
    more = rng.integers(nodes, size=(rng.integers(nodes), 2))
    edges += [(i, j) for i, j in more if i != j]
    return graph(nodes, [(int(i), int(j)) for i, j in edges])


def edges_of(near):
    return sum(len(n) for n in near) // 2


def central(x):
    m = paper.preset_means(x[None, :, 0])[0][..., None]
    return paper_vb.infer(x[None], paper_vb.paper_prior(m))


def assert_equal(got, whole, near_enough=1e-6):
    assert got.agreed
    assert got.r1 == pytest.approx(whole.r1[0], abs=near_enough)
    for m in got.m:
        assert m == pytest.approx(whole.q.m[0], abs=near_enough)
    for bound in got.bound:
        assert bound == pytest.approx(whole.bound[0, :, 1], rel=near_enough)


@pytest.mark.parametrize("nodes", range(2, 17))
def test_random_graphs_equal_the_central_unit_and_a_sweep_costs_2_n_1(nodes):
    for seed in range(4):
        x = loads(seed, nodes)
        near = random_graph(100 * nodes + seed, nodes)
        got = distributed.infer(x, near)
        assert_equal(got, central(x), 1e-9)
        assert got.sweeping.messages == 5 * 2 * (nodes - 1)
        assert got.sweeping.bytes == 8 * FLOATS * got.sweeping.messages
        # Flood and joining, then the largest load up and down.
        flood = got.setup.messages - 3 * (nodes - 1)
        assert nodes - 1 <= flood <= 2 * edges_of(near)
        # Exact: all nodes hold the same bits.
        assert (got.m == got.m[0]).all()
        assert (got.bound == got.bound[0]).all()


@pytest.mark.parametrize("nodes", [2, 3, 5, 16])
def test_consensus_on_rings_and_random_graphs_equals_the_central_unit(nodes):
    for near in (ring(nodes), random_graph(nodes, nodes)):
        x = loads(nodes, nodes)
        got = distributed.infer(x, near, exchange=Exchange.CONSENSUS)
        assert_equal(got, central(x))
        # Every round each edge is used both ways, in windows of N - 1 rounds.
        assert got.sweeping.messages == got.sweeping.rounds * 2 * edges_of(near)
        assert got.sweeping.rounds % (nodes - 1) == 0
        assert got.sweeping.bytes == 3 * 8 * FLOATS * got.sweeping.messages


@pytest.mark.parametrize(
    ("near", "depth", "setup"),
    [
        (tree(7), 2, 4 * 6),
        (tree(7, children=1), 6, 4 * 6),
        (tree(7, children=6), 1, 4 * 6),
        # Two arms of the flood meet on an edge: both its ends have spoken.
        (ring(7), 3, 4 * 6 + 2),
        # They meet at a node: it hears from both sides and answers one.
        (ring(6), 3, 4 * 5 + 1),
    ],
)
def test_messages_and_rounds_on_known_graphs(near, depth, setup):
    n = len(near)
    got = distributed.infer(loads(1, n), near)
    assert got.setup.messages == setup
    assert got.sweeping == (5 * 2 * (n - 1), 8 * 7 * 5 * 2 * (n - 1), 5 * 2 * depth)


@BOTH
def test_a_single_node_needs_no_message(exchange):
    x = np.array([[20.0]])
    got = distributed.infer(x, graph(1, []), exchange=exchange)
    assert_equal(got, central(x))
    assert got.sweeping == (0, 0, 0)


@BOTH
def test_numbering_of_the_nodes_does_not_matter(exchange):
    x = loads(9, 6)
    order = [3, 0, 5, 1, 4, 2]
    place = {old: new for new, old in enumerate(order)}
    near = random_graph(3, 6)
    moved = graph(6, [(place[i], place[j]) for i in range(6) for j in near[i]])
    a = distributed.infer(x, near, exchange=exchange)
    b = distributed.infer(x[order], moved, exchange=exchange)
    assert b.r1 == pytest.approx(a.r1[order], abs=1e-6)


def test_flood_leaves_a_spanning_tree_of_the_graph():
    for seed in range(20):
        near = random_graph(seed, 12)
        found = Tree(Wires(near))
        assert found.parent[0] is None
        for i in range(1, 12):
            assert found.parent[i] in near[i]
            assert i in found.children[found.parent[i]]
            path = i
            for _ in range(12):
                path = found.parent[path] if path else 0
            assert path == 0
        assert sum(len(c) for c in found.children) == 11


@pytest.mark.parametrize("adder", [Tree, Consensus])
def test_numbers_that_are_not_numbers_do_not_hang_the_network(adder):
    wires = Wires(ring(4))
    sums = adder(wires).total([np.array([1.0, np.nan])] * 4)
    assert sums[3][0] == pytest.approx(4.0)
    assert np.isnan(sums[3][1])


def test_consensus_that_cannot_agree_says_so(monkeypatch):
    monkeypatch.setattr("gateway.study.network.WINDOWS", 1)
    got = distributed.infer(loads(1, 8), ring(8), exchange=Exchange.CONSENSUS)
    assert not got.agreed


@pytest.mark.parametrize(
    ("edges", "message"),
    [([(0, 1)], "not connected"), ([(0, 0)], "no edge"), ([(0, 3)], "no edge")],
)
def test_impossible_graphs_are_refused(edges, message):
    with pytest.raises(ValueError, match=message):
        graph(3, edges)


def test_graph_must_fit_the_drives():
    with pytest.raises(ValueError, match="nodes"):
        distributed.infer(loads(0, 3), ring(4))
