"""Laws of the paper's detectors that hold for every number of drives, dimension and load."""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.cluster.vq import kmeans2

from estimators.detect import (
    GLOBAL_ESTIMATES,
    Evidence,
    KMeansDetector,
    MessagePassingDetector,
    PaperVariationalDetector,
    ReusingVariationalDetector,
    kmeans,
    message_passing,
    paper,
    paper_vb,
)
from estimators.detect.paper import Observe
from gateway.study import distributed
from gateway.study.network import graph
from tests.fuzz import examples
from tests.reference import message_passing as reference

# The first example loads scipy.special: no deadline is meaningful.
UNTIMED = settings(deadline=None)
PAPER = [KMeansDetector, MessagePassingDetector, ReusingVariationalDetector]
ORDERS = st.sampled_from(list(permutations(message_passing.ORDER)))


class Problem(NamedTuple):
    """x (T, N, D) and a prior that fits it."""

    x: np.ndarray
    prior: paper_vb.Params


@st.composite
def problems(draw: st.DrawFn, max_ticks: int = 3, max_drives: int = 16) -> Problem:
    T = draw(st.integers(1, max_ticks))
    N = draw(st.integers(1, max_drives))
    D = draw(st.integers(1, 2))
    numbers = st.floats(-60, 60).map(lambda v: round(v, 3))
    x = np.array(draw(st.lists(numbers, min_size=T * N * D, max_size=T * N * D)))
    m = np.array(draw(st.lists(numbers, min_size=T * 2 * D, max_size=T * 2 * D)))
    prior = paper_vb.paper_prior(
        m.reshape(T, 2, D),
        draw(st.sampled_from([100.0, 1.0, 0.01])),
        draw(st.sampled_from([2.0, 3.0, 12.0])),
        draw(st.sampled_from([0.05, 1.0, 50.0])),
    )
    return Problem(x.reshape(T, N, D), prior)


def never_falls(bound: np.ndarray) -> bool:
    """Over every partial update of every sweep; bound (T, S, B)."""
    line = bound.reshape(len(bound), -1)
    return bool((np.diff(line) >= -1e-10 * (1.0 + np.abs(line[:, 1:]))).all())


@UNTIMED
@given(problems(), st.integers(1, 12))
def test_vb_bound_never_falls_within_a_sweep_nor_over_sweeps(problem, sweeps):
    assert never_falls(paper_vb.infer(*problem, sweeps=sweeps).bound)


@UNTIMED
@given(problems(), st.integers(1, 12), ORDERS)
def test_vmp_bound_never_falls_within_a_sweep_nor_over_sweeps(problem, sweeps, order):
    priors = message_passing.paper_priors(problem.prior.m[..., 0])
    got = reference.infer(problem.x[..., 0], priors, order=order, sweeps=sweeps)
    assert never_falls(got.bound)


@UNTIMED
@given(problems(), st.integers(1, 5), st.randoms(use_true_random=False))
def test_vb_permuted_drives_give_permuted_answers(problem, sweeps, random):
    order = list(range(problem.x.shape[1]))
    random.shuffle(order)
    a = paper_vb.infer(*problem, sweeps=sweeps)
    b = paper_vb.infer(problem.x[:, order], problem.prior, sweeps=sweeps)
    assert np.allclose(a.r1[:, order], b.r1, atol=1e-6)
    assert np.allclose(a.q.m, b.q.m, atol=1e-6)


@UNTIMED
@given(problems(), st.integers(1, 5), ORDERS, st.randoms(use_true_random=False))
def test_vmp_permuted_drives_give_permuted_answers(problem, sweeps, messages, random):
    order = list(range(problem.x.shape[1]))
    random.shuffle(order)
    x, priors = problem.x[..., 0], message_passing.paper_priors(problem.prior.m[..., 0])
    a = reference.infer(x, priors, order=messages, sweeps=sweeps)
    b = reference.infer(x[:, order], priors, order=messages, sweeps=sweeps)
    assert np.allclose(a.r1[:, order], b.r1, atol=1e-6)
    assert np.allclose(a.m, b.m, atol=1e-6)


@UNTIMED
@given(problems())
def test_a_record_equals_its_ticks(problem):
    whole = paper_vb.infer(*problem)
    for t in range(len(problem.x)):
        prior = paper_vb.Params(*(a[t : t + 1] for a in problem.prior))
        alone = paper_vb.infer(problem.x[t : t + 1], prior)
        assert np.allclose(alone.r1[0], whole.r1[t], atol=1e-12)
        assert np.allclose(alone.bound[0], whole.bound[t], rtol=1e-12)


@UNTIMED
@given(problems(), st.data())
def test_an_unusable_drive_is_as_if_it_were_not_there(problem, data):
    T, N, _ = problem.x.shape
    usable = np.array(data.draw(st.lists(st.booleans(), min_size=N, max_size=N)))
    x = problem.x.copy()
    x[:, ~usable] = np.nan
    everywhere = np.broadcast_to(usable, (T, N))
    masked = paper_vb.infer(x, problem.prior, usable=everywhere)
    without = paper_vb.infer(problem.x[:, usable], problem.prior)
    assert np.allclose(masked.r1[:, usable], without.r1, atol=1e-9)
    assert np.allclose(masked.bound, without.bound, rtol=1e-9)
    assert not masked.r1[:, ~usable].any()
    priors = message_passing.paper_priors(problem.prior.m[..., 0])
    masked_vmp = reference.infer(x[..., 0], priors, usable=everywhere)
    without_vmp = reference.infer(problem.x[:, usable, 0], priors)
    assert np.allclose(masked_vmp.r1[:, usable], without_vmp.r1, atol=1e-9)
    assert np.allclose(masked_vmp.bound, without_vmp.bound, rtol=1e-9)


@UNTIMED
@given(problems())
def test_a_component_without_drives_keeps_its_prior(problem):
    """N_k -> 0: preset the lost component out of reach."""
    prior = problem.prior._replace(m=problem.prior.m.copy())
    prior.m[:, 1] = 1e6
    got = paper_vb.infer(problem.x, prior)
    assert not got.r1.any()
    for before, after in zip(prior[:4], got.q[:4], strict=True):
        assert (after[:, 1] == before[:, 1]).all()


def between(x: np.ndarray, centroid: np.ndarray) -> float:
    """How near to the middle between two centroids any drive is."""
    return float(np.abs(np.abs(x - centroid[0]) - np.abs(x - centroid[1])).min())


@UNTIMED
@given(st.lists(st.floats(-60, 60), min_size=2, max_size=16), st.integers(1, 6))
def test_kmeans_is_scipys(load, iterations):
    x = np.array(load).round(6)
    assume(np.ptp(x) > 0)
    # A drive as good as between the centroids may fall either way.
    for made in range(iterations):
        assume(between(x, kmeans.clusters(x[None], made).centroid[0]) > 1e-9)
    ours = kmeans.clusters(x[None], iterations)
    start = np.array([x.min(), x.max()])
    centroid, label = kmeans2(x, start, iter=iterations, minit="matrix", missing="raise")
    assert ours.label[0].tolist() == label.tolist()
    assert ours.centroid[0] == pytest.approx(centroid, rel=1e-12, abs=1e-12)


def anything() -> st.SearchStrategy[float]:
    return st.floats(allow_nan=True, allow_infinity=True) | st.floats(-60, 60)


@UNTIMED
@given(st.data(), st.integers(1, 16))
def test_detectors_never_raise_on_numbers(data, n):
    def row(numbers):
        return np.array(data.draw(st.lists(numbers, min_size=n, max_size=n)))

    usable = row(st.booleans())
    given_speed = row(anything()) if data.draw(st.booleans()) else None
    evidence = Evidence(row(anything()), row(anything()), usable, given_speed)
    by_quantity = [PaperVariationalDetector(observe=observe) for observe in Observe]
    for detector in [kind() for kind in PAPER] + by_quantity:
        opinion = detector(evidence)
        assert opinion.lost.shape == opinion.known.shape == (n,)
        assert not (opinion.known & ~usable).any()
        assert not (opinion.known & ~np.isfinite(evidence.load)).any()
        assert ((opinion.lost >= 0) & (opinion.lost <= 1)).all()
        assert np.isfinite(opinion.common)
        if usable.sum() < 2:
            assert not opinion.known.any()


@UNTIMED
@given(
    st.lists(st.floats(5, 60).map(lambda v: round(v, 2)), min_size=2, max_size=16),
    st.sampled_from(sorted(GLOBAL_ESTIMATES)),
)
def test_braking_mirrors_traction(load, name):
    x = np.array([load])
    # k-means gives a drive between the centroids to the lower cluster, so to the other one here.
    for iterations in (0, 1, 2) if name == "kmeans" else ():
        assume(np.ptp(x) == 0 or between(x[0], kmeans.clusters(x, iterations).centroid[0]) > 1e-9)
    method = GLOBAL_ESTIMATES[name]
    assert method(-x) == pytest.approx(-method(x), abs=1e-6)


@settings(max_examples=examples(30))
@given(problems(max_ticks=1), st.integers(0, 2**32 - 1))
def test_distributed_equals_central_on_any_connected_graph(problem, seed):
    rng = np.random.default_rng(seed)
    n = problem.x.shape[1]
    edges = [(i, int(rng.integers(i))) for i in range(1, n)]
    edges += [(int(i), int(j)) for i, j in rng.integers(n, size=(n // 2, 2)) if i != j]
    got = distributed.infer(problem.x[0], graph(n, edges), prior=problem.prior)
    whole = paper_vb.infer(*problem)
    assert got.r1 == pytest.approx(whole.r1[0], abs=1e-6)
    assert got.m == pytest.approx(np.broadcast_to(whole.q.m[0], got.m.shape), abs=1e-6)
    assert got.sweeping.messages == 2 * (n - 1) * paper.SWEEPS
