"""MAISD of the core by law, and equal to NumPy's on windows with holes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estimators import maisd
from tests.core_calls.maisd import average, push
from tests.reference import maisd as reference

tables = arrays(np.float64, (4, 3), elements=st.floats(-50, 300))


def spread(mean, known):
    return maisd.compare(mean, known)[0]


@given(tables)
def test_maisd_is_the_spread_of_the_motors(mean):
    known = np.ones(mean.shape, dtype=bool)
    assert spread(mean, known) == pytest.approx(mean.std(axis=0), abs=1e-9)


@given(tables, st.floats(-100, 100))
def test_maisd_ignores_what_all_motors_share_and_who_is_who(mean, shift):
    known = np.ones(mean.shape, dtype=bool)
    assert spread(mean + shift, known) == pytest.approx(spread(mean[::-1], known), abs=1e-6)


@given(arrays(np.float64, (40, 2, 3), elements=st.floats(-50, 300)), st.integers(1, 12))
def test_moving_average_looks_back_only(values, window):
    ring = maisd.window(window, 2, 3)
    present = np.ones((2, 3), dtype=bool)
    for k, value in enumerate(values):
        push(ring, k, value, present)
        mean, known = average(ring)
        if k + 1 >= window:
            assert known.all()
            assert mean == pytest.approx(values[k + 1 - window : k + 1].mean(axis=0), abs=1e-6)


def test_missing_values_are_left_out_and_few_are_not_known():
    ring = maisd.window(4, 2, 1)
    for k in range(4):
        push(ring, k, np.full((2, 1), 10.0 * k), np.array([[True], [k == 0]]))
    mean, known = average(ring)
    assert mean[0, 0] == 15.0
    assert known.tolist() == [[True], [False]]
    assert np.isnan(spread(mean, known)).all()


def test_deviation_is_against_the_median_of_the_others():
    mean = np.array([[10.0], [11.0], [12.0], [40.0]])
    deviation = maisd.compare(mean, np.ones((4, 1), dtype=bool))[1]
    assert deviation[:, 0].tolist() == [-2, -1, 1, 29]


@pytest.mark.parametrize("motors", [1, 2, 5, 16, 17, 130])
def test_it_equals_the_reference(motors):
    rng = np.random.default_rng(motors)
    plain, ring = reference.start(7, motors, 3), maisd.window(7, motors, 3)
    found = False
    for seen in range(40):
        # Whole degrees: motors that read the same have the same others.
        values, present = rng.normal(60.0, 3.0, (motors, 3)), rng.random((motors, 3)) < 0.6
        values[:, 0] = values[:, 0].round()
        plain = reference.push(plain, values, present)
        push(ring, seen, values, present)
        np.testing.assert_array_equal(ring, plain.ring)
        want_mean, want_known = reference.average(plain)
        mean, known = average(ring)
        np.testing.assert_allclose(mean, want_mean, rtol=1e-12)
        np.testing.assert_array_equal(known, want_known)
        spread, deviation = maisd.compare(mean, known)
        np.testing.assert_allclose(spread, reference.maisd(want_mean, want_known), rtol=1e-9)
        np.testing.assert_allclose(
            deviation, reference.deviation(want_mean, want_known), rtol=1e-9, atol=1e-12
        )
        found |= bool(np.isfinite(spread).any())
    assert found == (motors > 1)


@pytest.mark.parametrize("seen", [0, 3, 4, -1, -7, -(1 << 63), (1 << 63) - 1])
def test_any_count_is_a_place_in_the_ring(seen):
    """Also one below zero, which only a damaged record holds."""
    room = np.full((12, 2), 7.0)
    ring = room[4:8]
    push(ring, seen, np.ones(2), np.ones(2, bool))
    assert (room[:4] == 7.0).all()
    assert (room[8:] == 7.0).all()
    assert (ring == 1.0).all(axis=1).sum() == 1
