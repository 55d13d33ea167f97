"""exp, log, erfc and log Gamma of the core: exact values, error bounds of the header, limits."""

import math
from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest
from _traction_core import lib
from scipy import special

getcontext().prec = 60
RNG = np.random.default_rng(5)


def test_exp_is_right_to_the_bound_of_its_header():
    for x in [*RNG.uniform(-708.0, 709.0, 4000), *RNG.normal(0.0, 1.0, 4000), 0.0, 1.0, -1e-300]:
        want = Decimal(float(x)).exp()
        assert abs(Decimal(lib.elementary_exp(x)) / want - 1) < Decimal("4e-16"), x


@pytest.mark.parametrize("limit", [-708.0, 709.0])
def test_exp_is_a_number_up_to_its_limits_and_none_beyond(limit):
    want = Decimal(limit).exp()
    assert abs(Decimal(lib.elementary_exp(limit)) / want - 1) < Decimal("4e-16")
    beyond = lib.elementary_exp(math.nextafter(limit, math.copysign(math.inf, limit)))
    assert beyond == (0.0 if limit < 0.0 else math.inf)


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


def exact_log_gamma(x):
    """By Stirling's series at 60 and above, where its terms fall below 1e-50."""
    x, product = Decimal(float(x)), Decimal(1)
    while x < 60:
        product *= x
        x += 1
    bernoulli = [Fraction(1)]
    for n in range(1, 61):
        bernoulli.append(-sum(math.comb(n + 1, k) * b for k, b in enumerate(bernoulli)) / (n + 1))
    half_log_2pi = Decimal("0.91893853320467274178032973640561763986139747363778")
    total = (x - Decimal("0.5")) * x.ln() - x + half_log_2pi - product.ln()
    for k in range(1, 31):
        term = bernoulli[2 * k] / (2 * k * (2 * k - 1))
        total += Decimal(term.numerator) / Decimal(term.denominator) / x ** (2 * k - 1)
    return total


@pytest.mark.parametrize("times", [2, pytest.param(10, marks=pytest.mark.thorough)])
def test_log_gamma_is_right_to_the_bound_of_its_header(times):
    n = 10 * times
    for x in [*np.exp(RNG.uniform(-700.0, 700.0, 3 * n)), *RNG.uniform(0.0, 30.0, 10 * n),
              *(1.0 + RNG.normal(0.0, 1e-3, n)), *(2.0 + RNG.normal(0.0, 1e-3, n)),
              5e-324, 0.1, 0.5, 1.0, 1.5, 2.0, np.nextafter(10, 0), 10.0, 2.5e305]:  # fmt: skip
        want = exact_log_gamma(x)
        error = abs(Decimal(lib.elementary_log_gamma(x)) - want)
        assert error < Decimal("1e-14") * max(abs(want), 1), x


def test_gamma_of_whole_numbers_is_a_factorial():
    for n in range(1, 100):
        want = Decimal(math.factorial(n - 1)).ln()
        got = Decimal(lib.elementary_log_gamma(float(n)))
        assert abs(got - want) < Decimal("1e-14") * max(want, 1), n


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
    assert lib.elementary_log_gamma(math.inf) == lib.elementary_log_gamma(3e305) == math.inf
    for x in (math.nan, 0.0, -0.0, -1.5, -math.inf):
        assert math.isnan(lib.elementary_log_gamma(x)), x
