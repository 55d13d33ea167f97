"""Distributed variational Bayes: the nodes end where the central unit ends, and what it costs."""

import numpy as np
import pytest

from estimators.detect import paper, paper_vb, variational
from gateway.study import distributed
from gateway.study.distributed import Exchange
from gateway.study.network import Consensus, Tree, Wires, graph, ring, tree
from tests.reference import variational as reference

BOTH = pytest.mark.parametrize("exchange", list(Exchange))
FLOATS = {1: 7, 2: 13}
"""Numbers in a node's message: S0, S1, upper triangles of S2, entropy."""


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


def central(x, **keywords):
    m = paper.preset_means(x[None, :, 0])[0][..., None]
    return paper_vb.infer(x[None], paper_vb.paper_prior(m), **keywords)


def assert_equal(got, whole, near_enough=1e-6):
    assert got.agreed
    assert got.r1 == pytest.approx(whole.r1[0], abs=near_enough)
    for m in got.m:
        assert m == pytest.approx(whole.q.m[0], abs=near_enough)
    for bound in got.bound:
        assert bound == pytest.approx(whole.bound[0, : got.sweeps, 1], rel=near_enough)


@pytest.mark.parametrize("nodes", range(2, 17))
def test_random_graphs_equal_the_central_unit_and_a_sweep_costs_2_n_1(nodes):
    for seed in range(4):
        x = loads(seed, nodes)
        near = random_graph(100 * nodes + seed, nodes)
        got = distributed.infer(x, near)
        assert_equal(got, central(x), 1e-9)
        assert got.sweeping.messages == 5 * 2 * (nodes - 1)
        assert got.sweeping.bytes == 8 * FLOATS[1] * got.sweeping.messages
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
        assert got.sweeping.bytes == 3 * 8 * FLOATS[1] * got.sweeping.messages


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
def test_two_quantities_with_a_prior_that_all_nodes_know(exchange):
    rng = np.random.default_rng(2)
    x = np.stack([loads(4, 6)[:, 0], 50 + rng.normal(0, 1, 6)], axis=-1)
    m = np.array([[[20.0, 50.0], [5.0, 55.0]]])
    prior = paper_vb.paper_prior(m, W=0.1)
    got = distributed.infer(x, ring(6), prior=prior, exchange=exchange)
    assert_equal(got, paper_vb.infer(x[None], prior))
    size = FLOATS[2] * (1 if exchange is Exchange.TREE else 3)
    assert got.sweeping.bytes == 8 * size * got.sweeping.messages
    with pytest.raises(ValueError, match="prior"):
        distributed.infer(x, ring(6), exchange=exchange)


@BOTH
def test_stopping_by_the_bound_stops_all_nodes_in_the_central_units_sweep(exchange):
    near = random_graph(7, 5)
    prior = paper_vb.paper_prior(np.array([[[20.0], [10.0]]]), W=0.02)
    swept = set()
    for seed in range(8):
        x = loads(seed, 5)
        whole = paper_vb.infer(x[None], prior, sweeps=40, tolerance=1e-5)
        got = distributed.infer(x, near, prior=prior, sweeps=40, tolerance=1e-5, exchange=exchange)
        assert got.sweeps == whole.sweeps[0]
        assert_equal(got, whole)
        swept.add(got.sweeps)
    assert len(swept) > 1


@BOTH
@pytest.mark.parametrize("start", [0, 3])
def test_products_priors_fit_in(exchange, start):
    """The product starts each mean exactly at its preset (beta infinite), paper_vb at its prior."""
    x = np.array([20.0, 20.4, 9.0, 15.0, 19.7])
    p = variational.DEFAULT_PRIORS
    means, scatter = reference.starts(x, 0.49)
    expected = reference.infer(x, means, scatter, p)
    prior = paper_vb.Params(
        means[start][None, :, None],
        np.array([[p.beta_adhering, p.beta_lost]]),
        p.nu * scatter[start][None, :, None, None],
        np.full((1, 2), p.nu),
        np.array([[p.alpha_adhering, p.alpha_lost]]),
    )
    exact = prior._replace(beta=np.full((1, 2), np.inf))
    got = distributed.infer(x[:, None], tree(5), prior=prior, start=exact, exchange=exchange)
    assert got.r1 == pytest.approx(expected.r1[start], abs=1e-6)
    assert got.m[4, :, 0] == pytest.approx(expected.m[start], abs=1e-6)
    assert got.bound[2, -1] == pytest.approx(expected.bound[start], abs=1e-6)


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
