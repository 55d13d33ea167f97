"""The 2 sigma band of a load holds what it promises, and losses are found on reporting seeds."""

import numpy as np
import pytest

from bench.load_band import one, together
from gateway.study.evaluation import pooled
from gateway.study.evaluation_runs import Plan, fitted, judge, one_run, record
from gateway.study.scenarios_family import DEVELOPMENT, REPORTING
from gateway.study.scenarios_random import random_scenario

SEEDS = (41, 42)
PLAN = Plan(("single",), ("vb",), tuple(REPORTING), "traction.dbc")


@pytest.mark.parametrize(
    ("world", "kind", "motor"),
    [
        ("held", "one", "bench"),
        ("held", "rough", "bench"),
        ("ours", "single", "bench"),
        ("ours", "rough", "bench"),
    ],
)
def test_the_band_of_the_filters_holds_what_it_promises(world, kind, motor):
    found = together(one((world, kind, motor, seed)) for seed in SEEDS)
    mine = ~found.observed
    inside = np.abs(found.error[mine]) <= 2.0 * found.sigma[mine]
    assert mine.sum() > 300
    assert 0.9 < inside.mean() < 0.99


def test_a_sensor_that_is_noisier_widens_it():
    quiet, noisy = (one(("held", kind, "bench", SEEDS[0])) for kind in ("one", "rough"))
    assert np.median(noisy.sigma) > 2.0 * np.median(quiet.sigma)


def test_seeds_for_tuning_and_reporting_are_apart():
    assert not set(DEVELOPMENT) & set(REPORTING)


@pytest.mark.slow
def test_random_losses_on_the_classic_bus():
    score = pooled(one_run(PLAN, "single", seed)[0] for seed in REPORTING[:10]).flags
    assert score.f1 >= 0.95
    assert score.good_share >= 0.98
    assert score.median_delay_ms < 40


@pytest.mark.slow
def test_nothing_is_raised_on_healthy_runs():
    runs = []
    for seed in REPORTING[:6]:
        scenario = random_scenario(seed).model_copy(update={"event": []})
        fit = fitted(PLAN, "vb", scenario)
        runs.append(judge(record(scenario, *fit), *fit))
    score = pooled(runs).flags
    assert score.false_positive == 0
    assert score.good_share >= 0.98
