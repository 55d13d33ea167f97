"""The scale of the sensors' noise settles where the innovations are as large as they should be."""

import numpy as np
import pytest

from estimators.adapt import MOST, scale


def settle(true_scale, seconds=5.0, dt=2e-3, seed=0, now=1.0):
    """Innovations of a filter whose R is `now` times the configured and nothing else is noisy."""
    rng = np.random.default_rng(seed)
    at = []
    for k in range(round(seconds / dt)):
        nis = float(np.sum(rng.normal(size=2) ** 2)) * true_scale / now
        now = scale(now, nis, dt, k * dt)
        at.append(now)
    return at


@pytest.mark.parametrize("true_scale", [1.0, 5.0, 50.0])
def test_it_finds_the_scale_within_half_a_second_and_stays(true_scale):
    at = settle(true_scale)
    assert np.median(at[250:]) == pytest.approx(true_scale, rel=0.35)
    assert min(at) >= 1.0


def test_it_is_bounded_whatever_comes():
    assert settle(1e9)[-1] <= MOST
    assert scale(1.0, 0.0, 2e-3, 1.0) == 1.0
    assert scale(MOST, 1e300, 10.0, 0.0) == MOST


def test_a_burst_is_not_noise():
    at = settle(1.0, seconds=2.0)
    now = at[-1]
    for _ in range(15):
        now = scale(now, 1e3, 2e-3, 2.0)
    assert now < 1.35 * at[-1], "30 ms of an edge cost no more than this"
