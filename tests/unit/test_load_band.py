"""The 2 sigma band of a load says how far it is off: neither narrower nor wider."""

import numpy as np
import pytest

from bench.load_band import one, together

SEEDS = (41, 42)


@pytest.mark.parametrize(
    ("world", "kind", "motor"),
    [
        ("held", "one", "bench"),
        ("held", "rough", "bench"),
        ("families", "single", "bench"),
        ("families", "rough", "bench"),
        ("families", "crawl", "traction_350kw"),
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
