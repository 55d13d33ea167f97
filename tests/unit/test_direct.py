"""Compiled functions called without a look at their arguments: the same, and kept to."""

import numpy as np
import pytest
from numba import njit

from gateway._direct import Direct
from tests.keptypes import kept_types
from tests.soak.real import run
from tests.storm.campaign import FD_SEEDS, weather

CORE = {
    "tell",
    "compare", "conclude", "teach", "hear", "advance", "report",
    "fill_inputs", "send", "assess_train",
}  # fmt: skip
FILTERS = {"run_filters"}


@njit
def scaled(pair, factor, out):
    """Fills out with the first of a pair, by a factor."""
    out[:] = factor * pair[0]
    return pair[1]


def test_it_gives_what_the_function_gives_and_raises_what_it_raises():
    direct = Direct(scaled)
    for factor in (2.0, 3.0):
        out = np.empty(3)
        assert direct((np.arange(3.0), 7), factor, out) == 7
        np.testing.assert_array_equal(out, factor * np.arange(3.0))
    with pytest.raises(TypeError):
        direct((np.arange(3.0), 7), "two", out)
    assert direct.name == "scaled"


def test_another_type_is_noticed_in_tests():
    with kept_types() as called:
        direct = Direct(scaled)
        direct((np.arange(3.0), 7), 2.0, np.empty(3))
        with pytest.raises(
            AssertionError, match=r"scaled: argument 2 was array.*1d, C.* is array.*1d, A"
        ):
            direct((np.arange(3.0), 7), 2.0, np.empty(6)[::2])
        Direct(scaled)((np.arange(3.0), 7), 2.0, np.empty(6)[::2])
    assert called == {"scaled"}


@pytest.mark.parametrize("seed", [0, 2, 4, 8, 9, FD_SEEDS, FD_SEEDS + 2])
def test_the_core_keeps_to_its_types_in_any_weather(seed):
    """Both filters, all detectors, both message sets."""
    with kept_types() as called:
        weather(seed, 3000, between=60.0)
    assert called == CORE | FILTERS


def test_and_so_it_does_behind_a_socket(tmp_path):
    with kept_types() as called:
        run(1.5, tmp_path, every_s=0.3)
    assert called >= CORE | FILTERS
