"""Detection of random single losses on a few reporting seeds; `make bench` has the whole table."""

import pytest

from bench.adhesion import DEVELOPMENT, REPORTING, pooled


def test_seeds_for_tuning_and_reporting_are_apart():
    assert not set(DEVELOPMENT) & set(REPORTING)


@pytest.mark.slow
def test_random_losses_on_the_classic_bus():
    score = pooled(REPORTING[:10])
    assert score.f1 >= 0.95
    assert score.good_share >= 0.98
    assert score.median_delay_ms < 40


@pytest.mark.slow
def test_nothing_is_raised_on_healthy_runs():
    score = pooled(REPORTING[:6], healthy=True)
    assert score.false_positive == 0
    assert score.good_share >= 0.98
