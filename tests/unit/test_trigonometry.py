"""Sines, angles: exact to a rounding, on every machine the same."""

import math

import numpy as np
import pytest
from _traction_core import lib


def around(points):
    """These numbers, their neighbours, and both signs."""
    points = np.concatenate([points, np.nextafter(points, 9e9), np.nextafter(points, -9e9)])
    return (np.concatenate([points, -points]) + 0.0).tolist()


def test_sine_and_cosine():
    rng = np.random.default_rng(1)
    angles = np.concatenate([rng.uniform(0.0, 10.0, 3000), np.arange(60) * math.pi / 4])
    for angle in [*around(angles), *rng.uniform(-1e6, 1e6, 500).tolist(), 0.0, 1e-300]:
        assert lib.sine(angle) == pytest.approx(math.sin(angle), abs=3e-16)
        assert lib.cosine(angle) == pytest.approx(math.cos(angle), abs=3e-16)


def test_arc_tangent():
    rng = np.random.default_rng(2)
    ratios = np.concatenate([10.0 ** rng.uniform(-9, 9, 3000), [0.4375, 0.6875, 1.0, 0.0, 1e-300]])
    for y in around(ratios):
        for x in (1.0, -1.0):
            assert lib.arc_tangent(y, x) == pytest.approx(math.atan2(y, x), rel=4e-16, abs=1e-320)
    assert lib.arc_tangent(0.0, 0.0) == 0.0
    assert lib.arc_tangent(2.0, 0.0) == math.pi / 2
    assert lib.arc_tangent(-2.0, 0.0) == -math.pi / 2
    assert lib.arc_tangent(0.0, -3.0) == math.pi


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_no_number_has_no_angle(number):
    assert math.isnan(lib.sine(number))
    assert math.isnan(lib.cosine(number))
    assert math.isnan(lib.arc_tangent(math.nan, 1.0))
    assert math.isnan(lib.arc_tangent(1.0, math.nan))
    assert math.isnan(lib.wrap_angle(number))


def test_a_wrapped_angle_is_the_same_angle():
    for angle in np.random.default_rng(3).uniform(-1e4, 1e4, 1000).tolist():
        wrapped = lib.wrap_angle(angle)
        assert -math.pi < wrapped <= math.pi
        assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-11)
    assert lib.wrap_angle(math.pi) == math.pi
    assert lib.wrap_angle(-math.pi) == math.pi
