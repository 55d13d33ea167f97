"""Steps of sensors: found within half a minute, and nothing else is taken for one."""

import numpy as np
import pytest

from tests.core_calls.step_detector import offsets

NOISE_K = 0.25
WITHIN = 40
"""Samples at 1 Hz."""


def quiet(k=1200, seed=0, sensors=1):
    return NOISE_K * np.random.default_rng(seed).standard_normal((k, 1, sensors))


@pytest.mark.parametrize("size", [-12.0, -3.0, 2.5, 6.0])
def test_a_step_is_found_with_its_size_and_its_return(size):
    z = quiet()
    z[400:800] += size
    off = offsets(z, 1.0)[:, 0, 0]
    assert not off[:400].any()
    assert off[400 + WITHIN : 800] == pytest.approx(size, abs=0.4)
    assert not off[800 + WITHIN :].any()


def test_ten_times_the_rate_is_the_same_sensor():
    z = quiet(12_000)
    z[4000:8000] += 3.0
    off = offsets(z, 0.1)[:, 0, 0]
    assert off[4000 + 10 * WITHIN : 8000] == pytest.approx(3.0, abs=0.3)
    assert not off[:4000].any()
    assert not off[8000 + 10 * WITHIN :].any()


def test_heat_is_no_step():
    """8 K in less than a minute: faster than any fault warms a winding."""
    for seed in range(20):
        z = quiet(seed=seed)
        z[:, 0, 0] += np.interp(np.arange(1200), [300, 355, 700, 760], [0.0, 8.0, 8.0, 0.0])
        assert not offsets(z, 1.0).any()


def test_bursts_of_a_loose_connector_leave_no_offset():
    for seed in range(5):
        z = quiet(3600, seed)
        begins = np.flatnonzero(np.random.default_rng([seed, 1]).random(3600) < 0.01)
        for begin in begins:
            z[begin : begin + 5] += 25.0
        assert np.mean(offsets(z, 1.0) != 0.0) < 0.06


def test_holes_say_nothing_and_a_step_behind_one_is_found():
    z = quiet(sensors=2)
    z[::3, 0, 0] = np.nan
    z[395:420, 0, 0] = np.nan
    z[400:, 0, 0] += 5.0
    z[:, 0, 1] = np.nan
    off = offsets(z, 1.0)
    assert not off[:400].any()
    assert off[500:, 0, 0] == pytest.approx(5.0, abs=0.5)
    assert not off[:, 0, 1].any()


def test_what_comes_later_changes_nothing_and_snapshots_know_no_steps():
    z = quiet()
    z[400:800] += 4.0
    np.testing.assert_array_equal(offsets(z[:700], 1.0), offsets(z, 1.0)[:700])
    assert not offsets(z, 60.0).any()
