"""exp, log and erfc of the core: exact values, error bounds of the header, limits."""

from __future__ import annotations

import math
from decimal import Decimal, getcontext

import numpy as np
from _traction_core import lib
from scipy import special

getcontext().prec = 60
RNG = np.random.default_rng(5)


def test_exp_is_right_to_the_bound_of_its_header():
    for x in [*RNG.uniform(-708.0, 709.0, 4000), *RNG.normal(0.0, 1.0, 4000), 0.0, 1.0, -1e-300]:
        want = Decimal(float(x)).exp()
        assert abs(Decimal(lib.elementary_exp(x)) / want - 1) < Decimal("4e-16"), x


def test_log_is_right_to_the_bound_of_its_header():
    for x in [*np.exp(RNG.uniform(-700.0, 700.0, 4000)), *(1.0 + RNG.normal(0.0, 1e-3, 4000)),
              5e-324, 1.7e308, 1.0, math.sqrt(0.5), 2.0]:  # fmt: skip
        want = Decimal(float(x)).ln()
        error = abs(Decimal(lib.elementary_log(x)) - want)
        assert error < Decimal("4e-16") * max(abs(want), 1), x


def test_erfc_is_right_to_the_bound_of_its_header():
    """SciPy's errs by some 1e-15 itself."""
    x = np.concatenate([np.linspace(-6.0, 8.2, 20_001), RNG.normal(0.0, 1.0, 5000)])
    got = np.array([lib.elementary_erfc(float(one)) for one in x])
    np.testing.assert_allclose(got, special.erfc(x), rtol=2e-14, atol=0.0)


def test_what_has_no_value_or_none_that_is_finite():
    assert math.isnan(lib.elementary_exp(math.nan))
    assert lib.elementary_exp(-708.5) == lib.elementary_exp(-math.inf) == 0.0
    assert lib.elementary_exp(709.5) == lib.elementary_exp(math.inf) == math.inf
    assert math.isnan(lib.elementary_log(math.nan))
    assert lib.elementary_log(0.0) == lib.elementary_log(-1.0) == -math.inf
    assert lib.elementary_log(math.inf) == math.inf
    assert math.isnan(lib.elementary_erfc(math.nan))
    assert lib.elementary_erfc(math.inf) == 0.0
    assert lib.elementary_erfc(-math.inf) == 2.0
