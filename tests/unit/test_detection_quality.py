"""Detection of random single losses on a few reporting seeds; `make bench` has the whole table."""

import pytest

from bench.adhesion import DEVELOPMENT, REPORTING, pooled
from gateway.core.codes import Flag
from gateway.reports.delays import Loss
from gateway.reports.scoring import score_run


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


class Row:
    def __init__(self, t_s, drive, lost):
        self.t_s, self.drive, self.lost = t_s, drive, lost


class Track:
    def __init__(self, flags):
        self.seen = {("adhesion", 1): [(round(t * 1e9), f) for t, f in flags]}


def test_scoring_counts_frames_away_from_edges():
    truth = [Row(k / 100, 1, 100 <= k < 150) for k in range(300)]
    flags = [(k / 100, Flag.BAD if 103 <= k < 153 else Flag.GOOD) for k in range(300)]
    score = score_run(truth, Track(flags), (1,))
    assert score[:7] == (45, 0, 0, 195, 195, (pytest.approx(30.0),), 0)
    assert score.f1 == 1.0


def test_scoring_knows_misses_false_alarms_and_unknown():
    truth = [Row(k / 100, 1, 100 <= k < 150) for k in range(300)]
    silent = score_run(truth, Track([(k / 100, Flag.UNKNOWN) for k in range(300)]), (1,))
    assert silent.f1 == 0.0
    assert silent.good_share == 0.0
    assert silent.missed == 1
    always = score_run(truth, Track([(k / 100, Flag.BAD) for k in range(300)]), (1,))
    assert always.false_positive == always.healthy > 0
    assert Loss(1, 1.0, 1.5).end_s == 1.5
