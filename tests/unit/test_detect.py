"""Detectors: the paper's equations by law, and what each detector is for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.detect import DETECTORS, Evidence, MedianDetector, VariationalDetector
from estimators.detect.variational import DEFAULT_PRIORS
from tests.reference.variational import infer, starts

loads = st.lists(st.floats(-60, 60), min_size=2, max_size=40).map(np.array)


def evidence(*load, spread=0.7, usable=None):
    x = np.array(load, dtype=float)
    good = np.ones(len(x), dtype=bool) if usable is None else np.array(usable)
    return Evidence(x, np.full(len(x), spread), good)


@given(loads, st.randoms(use_true_random=False))
def test_permuted_drives_give_permuted_answers(x, random):
    order = list(range(len(x)))
    random.shuffle(order)
    for detector in (kind() for kind in DETECTORS.values()):
        a = detector(evidence(*x))
        b = detector(evidence(*x[order]))
        bounds = np.sort(infer(x, *starts(x, 0.49), DEFAULT_PRIORS).bound)
        if len(x) > 1 and bounds[-1] - bounds[-2] < 1e-6:
            continue  # two explanations equally good: which one wins is arbitrary
        assert np.allclose(a.lost[order], b.lost, atol=1e-6)


@pytest.mark.parametrize("kind", DETECTORS.values())
@pytest.mark.parametrize("sign", [1, -1])
def test_one_lost_drive_is_found_in_traction_and_braking(kind, sign):
    opinion = kind()(evidence(20 * sign, 10 * sign, 20.3 * sign))
    assert opinion.known.all()
    assert (opinion.lost > 0.9).tolist() == [False, True, False]
    assert opinion.common == pytest.approx(20 * sign, abs=0.5)


@pytest.mark.parametrize("kind", DETECTORS.values())
def test_healthy_drives_and_a_coasting_train_are_not_accused(kind):
    for load in ((20, 20.6, 19.5), (0.1, -0.3, 0.4), (-15, -15.4, -14.8)):
        assert (kind()(evidence(*load)).lost < 0.5).all()


@pytest.mark.parametrize("kind", DETECTORS.values())
def test_too_few_usable_drives_are_unknown(kind):
    assert not kind()(evidence(20)).known.any()
    assert not kind()(evidence(20, 5, 20, usable=[True, False, False])).known.any()
    opinion = kind()(evidence(20, 5, 20.2, usable=[True, False, True]))
    assert opinion.known.tolist() == [True, False, True]
    assert (opinion.lost < 0.5).all()


def test_majority_slipping_does_not_accuse_the_healthy_one():
    opinion = VariationalDetector()(evidence(20, 9, 8))
    assert (opinion.lost > 0.9).tolist() == [False, True, True]
    # The median's known weakness, stated in its docstring.
    assert MedianDetector()(evidence(20, 9, 8)).lost.max() < 0.5


@pytest.mark.parametrize("n", [17, 100, 1024])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6])
def test_a_large_fleet_needs_no_start_at_every_drive(n, share):
    rng = np.random.default_rng(n)
    lost = np.arange(n) < max(round(share * n), 1)
    load = np.where(lost, 8.0, 20.0) + rng.normal(0.0, 0.5, n)
    opinion = VariationalDetector()(evidence(*load))
    np.testing.assert_array_equal(opinion.lost > 0.5, lost)
    assert opinion.common == pytest.approx(20.0, abs=0.3)


def test_more_load_than_the_others_is_not_a_lost_wheel():
    assert (VariationalDetector()(evidence(24, 20, 20.1)).lost < 0.5).all()


@given(loads)
def test_probability_is_one(x):
    for kind in DETECTORS.values():
        opinion = kind()(evidence(*x))
        assert ((opinion.lost >= 0) & (opinion.lost <= 1)).all()
