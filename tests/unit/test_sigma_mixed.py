"""`sigma_mixed.c` and `gaussian_mixture.c` equal their NumPy forms."""

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.records import pointer
from estimators.thermal.sigma_mixed import KAPPA, Lumps, SigmaMixedFilter, estimate
from tests.core_calls import mixture
from tests.reference import mixture as reference_mixture
from tests.reference import sigma_mixed as reference


@pytest.mark.parametrize("components", [1, 2, 3, 8])
@pytest.mark.parametrize("kind", ["humps", "alike", "outlier", "two values"])
def test_a_mixture_equals_the_reference(components, kind):
    rng = np.random.default_rng(components)
    x = {
        "humps": np.concatenate([rng.normal(0.0, 1.0, 60), rng.normal(8.0, 2.0, 20)]),
        "alike": np.full(30, 3.0),
        "outlier": np.r_[rng.normal(0.0, 1.0, 40), 1e4],
        "two values": np.r_[np.zeros(20), np.ones(3)],
    }[kind]
    want = np.empty((3, components))
    reference_mixture.expect_maximise(x, 10, 1e-4, want)
    got = mixture.fit(x, components, 10)
    np.testing.assert_allclose(np.array(got), want, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("iterations", [0, 1, 2])
def test_the_first_values_and_those_after_few_steps_equal_the_reference(iterations):
    """What lies behind the values is not read: their variance starts every component."""
    behind = np.full(60, 1e9)
    x = behind[:40]
    x[:] = np.random.default_rng(3).normal(60.0, 5.0, 40)
    want, found = np.empty((3, 3)), ffi.new("struct mixture *")
    reference_mixture.expect_maximise(x, iterations, 1e-4, want)
    lib.mixture_fit(
        pointer("double", x), pointer("double", np.sort(x)), 40, iterations, 1e-4, 3, found
    )
    got = [list(part)[:3] for part in (found.weight, found.mean, found.variance)]
    np.testing.assert_allclose(got, want, rtol=1e-9)


def test_a_component_that_no_value_belongs_to_has_no_weight_and_stays_where_it_is():
    """The first values of its components are the caller's, by the sorted numbers."""
    x, first = np.random.default_rng(0).normal(size=20), np.repeat([0.0, 1e6], 10)
    found = ffi.new("struct mixture *")
    lib.mixture_fit(pointer("double", x), pointer("double", first), 20, 5, 1e-4, 2, found)
    assert list(found.weight)[:2] == [1.0, 0.0]
    assert found.mean[1] == 1e6
    assert found.mean[0] == pytest.approx(x.mean())


def test_a_mixture_has_at_least_one_component_and_no_more_than_there_is_room_for():
    for components in (0, mixture.MOST_COMPONENTS + 1):
        with pytest.raises(ValueError, match="components"):
            mixture.fit(np.arange(20.0), components)


@pytest.mark.parametrize(
    ("weighted", "kappa", "samples"),
    [(False, KAPPA, 120), (True, KAPPA, 120), (True, 1.0, 120), (True, KAPPA, 1)],
)
def test_the_filter_equals_the_reference(weighted, kappa, samples):
    """Readings with holes, of points that agree, and of points that do not at all."""
    rng = np.random.default_rng(int(weighted))
    motors = 4
    y = 60.0 + np.cumsum(rng.normal(0.0, 0.3, (samples, motors, 3)), axis=0)
    y[:, 3] += np.array([0.0, 900.0, -900.0])
    y[rng.random(y.shape) < 0.1] = np.nan
    settled = np.tile(60.0 + np.sin(np.arange(samples) / 9.0)[:, None, None], (1, motors, 3))
    keep = rng.uniform(0.0, 1.0, y.shape)
    gap, none = rng.uniform(0.0, 60.0, samples), np.zeros((motors, 3))
    drift = rng.normal(0.0, 1e-3, none.shape)
    q, r = rng.uniform(1e-3, 2.0, (2, motors, 3))
    q[2], apart = 0.0, np.array([10.0, -4.0, -6.0])
    state, mixed = np.empty(y.shape), np.empty(y.shape[:2])
    options = np.array([kappa, 0.2, float(weighted)])
    reference.sweep(y, settled, keep, drift, gap, q, r, apart, options, state, mixed)
    configs = SigmaMixedFilter(weighted).configs(Lumps(none, none, none, q, r, apart), drift)
    configs["kappa"] = kappa
    got = estimate(configs, y, settled, keep, gap)
    np.testing.assert_allclose(got.state, state, rtol=1e-8)
    np.testing.assert_allclose(got.mixed, mixed, rtol=1e-8)


def test_no_samples_are_no_estimates():
    none = np.zeros((1, 3))
    configs = SigmaMixedFilter().configs(Lumps(none, none, none, none, none + 1.0, none[0]), none)
    empty = np.empty((0, 1, 3))
    assert estimate(configs, empty, empty, empty, np.empty(0)).state.shape == (0, 1, 3)
