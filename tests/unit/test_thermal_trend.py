"""Degradation: the rate of a line, its uncertainty, and what is no degradation."""

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.records import TREND, pointer
from estimators.thermal import trend as module
from tests.reference.trend import ENOUGH_H, READING_K
from tests.reference.trend import Trend as Reference

BLOCK_H = 30.0 / 3600.0


def course(rate_k_h, hours, seed=0, motors=3):
    t = np.arange(round(hours / BLOCK_H))[:, None] * BLOCK_H
    noise = READING_K * np.random.default_rng(seed).standard_normal((len(t), motors))
    return rate_k_h * t + noise


class Trend:
    """M motors, each its record."""

    def __init__(self, motors):
        self.records = np.zeros(motors, TREND)
        self.each = pointer("struct trend", self.records)
        for one in self.each:
            lib.trend_reset(ffi.addressof(one))

    def take(self, deviation, hours):
        for one, kelvin in zip(self.each, deviation.tolist(), strict=True):
            lib.trend_add(ffi.addressof(one), kelvin, hours)

    @property
    def level(self):
        return self.records["level_k"]

    def told(self, m):
        return module.rate_of(self.records[m : m + 1])

    def time_to(self, m, limit_k):
        return module.time_to(self.records[m : m + 1], limit_k)


@pytest.mark.parametrize("seed", range(4))
def test_it_equals_the_reference(seed):
    """Lines with jumps and holes, and motors that nothing is seen of."""
    rng = np.random.default_rng(seed)
    ours, theirs = Trend(5), Reference(5)
    jump = np.zeros(5)
    for _ in range(600):
        jump += np.where(rng.random(5) < 0.01, rng.normal(0.0, 8.0, 5), 0.0)
        deviation = jump + rng.normal(0.0, 0.5, 5)
        deviation[rng.random(5) < 0.2] = np.nan
        deviation[4] = np.nan
        hours = float(rng.choice([1e-4, 0.01, 0.5]))
        ours.take(deviation, hours), theirs.take(deviation, hours)
        for name, wanted in (("level_k", theirs.level), ("rate_k_h", theirs.rate),
                             ("cov", theirs.cov), ("observed_h", theirs.hours)):  # fmt: skip
            np.testing.assert_allclose(ours.records[name], wanted, rtol=1e-9, atol=1e-12)
        for m in range(5):
            one, two = ours.told(m), theirs.told(m)
            assert (one is None) == (two is None)
            assert one is None or one == pytest.approx(two, rel=1e-9)


def run(deviations):
    trend = Trend(deviations.shape[1])
    for row in deviations:
        trend.take(row, BLOCK_H)
    return trend


def test_a_line_has_its_slope_within_its_uncertainty():
    errors = []
    for seed in range(10):
        trend = run(course(0.2, 24.0, seed))
        for m in range(3):
            rate, sigma = trend.told(m)
            errors.append((rate - 0.2) / sigma)
            assert sigma < 0.1
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.5, abs=0.5)


def test_time_to_a_limit_is_told_only_when_it_comes():
    trend = run(course(0.5, 24.0))
    assert trend.time_to(0, 20.0) == pytest.approx((20.0 - 12.0) / 0.5, rel=0.3)
    assert trend.time_to(0, 5.0) is None, "it is there already"
    assert run(course(0.0, 24.0)).time_to(0, 5.0) is None
    assert run(course(-0.5, 24.0)).time_to(0, 5.0) is None


def test_a_jump_moves_the_level_and_not_the_rate():
    deviations = course(0.0, 24.0)
    deviations[1500:, 1] += 8.0
    trend = run(deviations)
    rate, sigma = trend.told(1)
    assert abs(rate) < 2.0 * sigma
    assert trend.level[1] == pytest.approx(8.0, abs=0.7)


def test_what_is_off_by_three_kelvin_is_no_jump_yet():
    trend = run(np.array([[0.0, 0.0], [3.0, 3.001]]))
    assert trend.level[0] < 3.0 < trend.level[1]
    assert trend.records["rate_k_h"][0] > 0.0 == trend.records["rate_k_h"][1]


def test_nothing_is_told_before_enough_was_seen():
    short = round(0.9 * ENOUGH_H / BLOCK_H)
    assert run(course(1.0, 2.0)[:short]).told(0) is None
    holes = course(1.0, 6.0)
    holes[:, 2] = np.nan
    trend = run(holes)
    assert trend.told(2) is None
    assert trend.told(0)[0] == pytest.approx(1.0, abs=0.3)
