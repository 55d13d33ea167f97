"""`estimators/detect/variational.c` against NumPy and SciPy: any loads, extreme ones too."""

import numpy as np
import pytest
from _traction_core import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import digamma

from dbc.records import VB_PRIORS
from estimators.detect import Evidence, VariationalDetector
from estimators.detect.variational import DEFAULT_PRIORS, Priors
from tests.reference.variational import VB_MAX_STARTS, infer, starts

loads = st.lists(st.floats(-60, 60), min_size=2, max_size=40).map(np.array)
VARIANCE = 0.49


def detect(x, variance=VARIANCE, priors=DEFAULT_PRIORS, iterations=5, usable=None):
    """Of loads that all have one spread: (lost, common)."""
    usable = np.ones(len(x), dtype=np.bool_) if usable is None else usable
    spread = np.full(len(x), np.sqrt(variance))
    opinion = VariationalDetector(priors, iterations)(Evidence(x, spread, usable))
    return opinion.lost, opinion.common


def answers(x, variance=VARIANCE, priors=DEFAULT_PRIORS, iterations=5):
    """Of the reference: of every start that may win, (lost, common)."""
    posterior = infer(x, *starts(x, variance), priors, iterations)
    for j in np.flatnonzero(posterior.bound >= posterior.bound.max() - 1e-9):
        common = posterior.m[j, 0]
        less = (common - x) * (1.0 if common >= 0.0 else -1.0)
        # As far below the common load as a healthy drive may be: either answer is right.
        either = np.abs(less - np.sqrt(variance)) < 1e-7
        yield np.where(less > np.sqrt(variance), posterior.r1[j], 0.0), common, either


def same(x, *given, lost, common):
    return any(
        common == pytest.approx(m, abs=1e-8) and np.allclose(lost[~either], r[~either], atol=1e-8)
        for r, m, either in answers(x, *given)
    )


def test_priors_are_in_the_order_of_the_record():
    assert Priors._fields == VB_PRIORS.names


@given(st.floats(1e-3, 1e4))
def test_digamma_is_scipys(x):
    assert lib.digamma(x) == pytest.approx(digamma(x), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("x", [0.0, -0.0, -1.5, -1e300, -np.inf, np.nan])
def test_digamma_of_what_is_not_positive_is_nan(x):
    assert np.isnan(lib.digamma(x))


def test_digamma_where_the_series_begins_and_ends():
    for x in (1e-300, 9.999999, 10.0, 10.000001, 1e300):
        assert lib.digamma(x) == pytest.approx(digamma(x), rel=1e-12)


@given(loads, st.integers(1, 6))
def test_any_loads(x, iterations):
    lost, common = detect(x, iterations=iterations)
    assert same(x, VARIANCE, DEFAULT_PRIORS, iterations, lost=lost, common=common)


PRIORS = (DEFAULT_PRIORS, Priors(3.0, 0.5, 2.0, 4.0, 1.5), Priors(40.0, 2.0, 0.3, 1.0, 3.0))


@pytest.mark.parametrize("priors", PRIORS)
@pytest.mark.parametrize("n", [2, 3, 5, VB_MAX_STARTS, VB_MAX_STARTS + 1, 48])
def test_trains_with_losses(n, priors):
    rng = np.random.default_rng(n)
    accused = 0
    for _ in range(60):
        level, variance = rng.choice([-20.0, 0.6, 20.0]), rng.choice([0.01, 0.49])
        share = rng.choice([1.0, 1.0, 1.0, 0.4, 0.0], n)
        x = level * share + rng.normal(0.0, np.sqrt(variance), n)
        lost, common = detect(x, variance, priors)
        assert same(x, variance, priors, lost=lost, common=common)
        accused += int((lost > 0.5).any())
    assert accused > 0


def test_drives_that_are_not_usable_count_for_nothing():
    rng = np.random.default_rng(4)
    for _ in range(100):
        n = int(rng.integers(2, 20))
        x, usable = rng.choice([20.0, 8.0], n) + rng.normal(0.0, 0.7, n), rng.random(n) < 0.7
        told = x.copy()
        told[~usable] = rng.choice([np.nan, np.inf, 1e308], n)[~usable]
        lost, common = detect(told, usable=usable)
        assert not lost[~usable].any()
        if np.count_nonzero(usable) < 2:
            assert not lost.any()
            assert common == 0.0
            continue
        alone, mean = detect(x[usable])
        np.testing.assert_array_equal(lost[usable], alone)
        assert common == mean


def raw(load, spread, usable, priors=DEFAULT_PRIORS, iterations=5):
    """The C function itself."""
    n = len(load)
    lost, workspace = np.full(n, 7.0), np.full(5 * n, 7.0)
    common = lib.vb_detect(
        ffi.new("struct vb_priors *", priors), iterations,
        *(ffi.from_buffer("double[]", column) for column in (load, spread)),
        ffi.from_buffer("uint8_t[]", usable), n, ffi.from_buffer("double[]", workspace),
        ffi.from_buffer("double[]", lost),
    )  # fmt: skip
    return lost, common


def test_fewer_than_two_drives_are_no_comparison():
    for n, usable in ((0, []), (1, [1]), (3, [0, 1, 0])):
        x = np.full(n, 20.0)
        lost, common = raw(x, x, np.array(usable, dtype=np.uint8))
        assert not lost.any()
        assert common == 0.0


def test_equal_explanations_the_first_one_wins():
    lost, common = raw(*(np.array(c) for c in ([5.0, -5.0], [0.1, 0.1])), np.ones(2, np.uint8))
    assert common > 0.0
    assert lost[1] > 0.9


def test_numbers_that_are_none_end_in_no_probability_above_one():
    rng = np.random.default_rng(5)
    odd = [0.0, 1.0, -3.0, 1e308, -1e308, 1e-320, np.nan, np.inf, -np.inf]
    for _ in range(3000):
        n = int(rng.integers(2, 20))
        load, spread = rng.choice(odd, (2, n))
        priors = rng.choice([1.0, 12.0, *odd], 5).tolist()
        usable = rng.choice(np.array([0, 1, 255], dtype=np.uint8), n)
        lost, _ = raw(load, spread, usable, priors, int(rng.integers(-1, 6)))
        assert (np.isnan(lost) | ((lost >= 0.0) & (lost <= 1.0))).all()
