"""`estimators/order_statistics.c`, which only other sources call, equals Python's."""

import ctypes
import math
import statistics

import _traction_core
import numpy as np
import pytest

CORE = ctypes.CDLL(_traction_core.__file__)
Double, Int = ctypes.c_double, ctypes.c_int


class Ranking(ctypes.Structure):
    """`struct ranking`."""

    _fields_ = (("numbers", ctypes.POINTER(Double)), ("count", Int))


CORE.median_in_place.restype = CORE.median_of_others.restype = Double
CORE.median_of_others.argtypes = ctypes.POINTER(Ranking), Double, Int
CORE.ranking_add.argtypes = ctypes.POINTER(Ranking), Double


@pytest.mark.parametrize("n", [*range(20), 40, 41, 150, 1000])
def test_numbers_are_sorted_and_have_a_median(n):
    rng = np.random.default_rng(n)
    for digits in (0, 9):
        values = rng.normal(0.0, 3.0, n).round(digits).tolist()
        room = (Double * (n + 1))(*values, -99.0)
        CORE.sort_ascending(room, n)
        assert room[:] == [*sorted(values), -99.0], "the one behind is left alone"
        room[:n] = values
        assert not n or CORE.median_in_place(room, n) == statistics.median(values)


@pytest.mark.parametrize("n", range(12))
def test_the_median_of_others_leaves_out_one_number_and_every_nan(n):
    rng = np.random.default_rng(n)
    values = rng.normal(0.0, 2.0, n).round().tolist()
    room = (Double * (n + 1))(*[-99.0] * (n + 1))
    ranking = Ranking(room, 0)
    for value in values:
        CORE.ranking_add(ranking, value)
        CORE.ranking_add(ranking, math.nan)
    assert room[:] == [*values, -99.0]
    CORE.sort_ascending(room, n)
    for own in (math.nan, *values):
        others = values.copy()
        if own == own:
            others.remove(own)
        for upper, median in enumerate((statistics.median_low, statistics.median_high)):
            want = median(others) if others else math.nan
            got = CORE.median_of_others(ranking, own, upper)
            assert got == want or (not others and math.isnan(got))
