"""Laws of the paper's detectors that hold for every number of drives, dimension and load."""

from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.detect import (
    Evidence,
    KMeansDetector,
    MessagePassingDetector,
    PaperVariationalDetector,
    ReusingVariationalDetector,
    paper_vb,
)
from estimators.detect.paper import Observe

# The first example loads scipy.special: no deadline is meaningful.
UNTIMED = settings(deadline=None)
PAPER = [KMeansDetector, MessagePassingDetector, ReusingVariationalDetector]


class Problem(NamedTuple):
    """x (T, N, D) and a prior that fits it."""

    x: np.ndarray
    prior: paper_vb.Params


@st.composite
def problems(draw, max_ticks=3, max_drives=16):
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


def never_falls(bound):
    """Over every partial update of every sweep; bound (T, S, B)."""
    line = bound.reshape(len(bound), -1)
    return bool((np.diff(line) >= -1e-10 * (1.0 + np.abs(line[:, 1:]))).all())


@UNTIMED
@given(problems(), st.integers(1, 12))
def test_vb_bound_never_falls_within_a_sweep_nor_over_sweeps(problem, sweeps):
    assert never_falls(paper_vb.infer(*problem, sweeps=sweeps).bound)


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


def anything():
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
