"""Paper `thermal`: mixture by EM, sigma-mixed filter, jump diffusion, MAISD method; by law."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from sklearn.mixture import GaussianMixture

from estimators.thermal import degradation
from estimators.thermal.maisd_method import PaperMethod
from estimators.thermal.record import Record
from estimators.thermal.sigma_mixed import SigmaMixedFilter, lumps
from tests.core_calls import mixture


def two_humps(seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(0.0, 1.0, 300), rng.normal(8.0, 2.0, 100)])


def test_em_agrees_with_an_independent_library():
    x = two_humps()
    ours = mixture.fit(x, 2, iterations=300)
    theirs = GaussianMixture(2, random_state=0, tol=1e-9, max_iter=1000, reg_covar=1e-9).fit(
        x[:, None]
    )
    order = np.argsort(theirs.means_[:, 0])
    np.testing.assert_allclose(ours.weight, theirs.weights_[order], atol=1e-3)
    np.testing.assert_allclose(ours.mean, theirs.means_[order, 0], atol=1e-2)
    np.testing.assert_allclose(ours.variance, theirs.covariances_[order, 0, 0], rtol=1e-2)


def test_no_iteration_lowers_the_likelihood():
    x = two_humps(3)
    levels = [mixture.log_likelihood(x, mixture.fit(x, 3, iterations=n)) for n in range(1, 40)]
    assert min(np.diff(levels)) > -1e-8


def test_the_printed_mean_is_not_the_mixtures():
    found = mixture.fit(two_humps(), 2)
    x = two_humps()
    assert found.mixed_mean == pytest.approx(x.mean(), abs=1e-6), "EM keeps the mean"
    assert found.mixed_variance == pytest.approx(x.var(), rel=1e-3)
    assert found.printed_mean == pytest.approx(4.0, abs=0.3)


def test_equal_values_do_not_collapse_a_component():
    found = mixture.fit(np.full(9, 3.0), 3)
    assert np.all(found.variance >= 1e-4)
    np.testing.assert_allclose(found.mean, 3.0)
    with pytest.raises(ValueError, match="3 components"):
        mixture.fit(np.array([1.0, 2.0]), 3)
    with pytest.raises(ValueError, match="finite"):
        mixture.fit(np.array([1.0, np.nan, 2.0, 3.0]), 3)


def train_record(k=200, m=4, seed=0, noise=0.3):
    """Motors that are one lump a point, exactly: K samples, 10 steps of 60 s between them."""
    rng = np.random.default_rng(seed)
    steps = 10 * k
    square = np.repeat(rng.uniform(0.0, 2e4, steps // 20), 20)[:, None] * np.ones(m)
    ambient = 15.0 + 5.0 * np.sin(np.arange(steps) / 300.0)
    at = np.arange(10, steps + 1, 10) - 1
    temperature = np.empty((k, m, 3))
    for p, (gain, xi) in enumerate([(2e-3, 1 / 600), (1e-3, 1 / 2000), (0.9e-3, 1 / 2000)]):
        for i in range(m):
            t, keep, out = ambient[0] + gain * square[:, i].mean(), np.exp(-xi * 60.0), []
            for n in range(steps):
                t = keep * t + (1.0 - keep) * (gain * square[n, i] + ambient[n])
                out.append(t)
            temperature[:, i, p] = np.array(out)[at] + noise * rng.standard_normal(k)
    return Record(temperature, at, square, np.zeros(steps), ambient, 60.0)


def test_lumps_are_found():
    known = lumps(train_record(noise=0.05))
    np.testing.assert_allclose(known.gain[:, 0], 2e-3, rtol=0.05)
    np.testing.assert_allclose(known.loss[:, 0], 1 / 600, rtol=0.25)
    assert np.abs(known.apart.sum()) < 1e-9


def test_without_mixing_it_is_the_kalman_filter():
    record = train_record(60, 1)
    known = lumps(record)
    states = SigmaMixedFilter(mixing=0.0).run(record, known).state
    settled = SigmaMixedFilter(mixing=0.0)
    assert settled.weighted is False
    # The same by filterpy: x is the distance from where the inputs drive each point.
    from estimators.thermal.sigma_mixed import _forced

    drive = np.empty((60, 3))
    for p in range(3):
        heat, air = _forced(record, 0, float(known.loss[0, p]))
        drive[:, p] = known.gain[0, p] * heat + air + known.offset[0, p]
    keep = np.exp(-known.loss[0] * 600.0)
    kf = KalmanFilter(dim_x=3, dim_z=3)
    kf.x = (record.temperature[0, 0] - drive[0])[:, None]
    kf.P = np.diag(known.r[0] + known.q[0])
    kf.H, kf.R = np.eye(3), np.diag(known.r[0])
    for k in range(60):
        step = np.ones(3) if k == 0 else keep
        kf.F, kf.Q = np.diag(step), np.diag(known.q[0] * (1.0 - step**2))
        kf.predict()
        kf.update(record.temperature[k, 0] - drive[k])
        np.testing.assert_allclose(states[k, 0], kf.x[:, 0] + drive[k], atol=1e-6)


def test_missing_readings_predict_only():
    record = train_record(80)
    known = lumps(record)
    holes = record.temperature.copy()
    holes[30:40, 1] = np.nan
    state = SigmaMixedFilter().run(record._replace(temperature=holes), known).state
    assert np.isfinite(state).all()
    full = SigmaMixedFilter().run(record, known).state
    np.testing.assert_array_equal(state[:30], full[:30])
    np.testing.assert_allclose(state[30:40, 1], full[30:40, 1], atol=3.0)


def jumpy(seed, k=360, drift=0.05, sigma=0.25, noise=0.4):
    rng = np.random.default_rng(seed)
    where = rng.random(k) < 0.02
    where[0] = False
    size = np.where(where, rng.choice([-5.0, 5.0], k), 0.0)
    x = drift * np.arange(k) + np.cumsum(sigma * rng.normal(size=k) + size)
    return x + noise * rng.normal(size=k), where[1:]


def test_the_jump_diffusion_is_found_without_bias():
    found, missed = [], 0
    for seed in range(30):
        y, where = jumpy(seed)
        fit = degradation.fit(y, np.arange(360.0))
        found.append((fit.drift, fit.diffusion, fit.noise))
        missed += np.count_nonzero(where & ~degradation.jump_points(y))
    mean = np.mean(found, axis=0)
    assert mean[0] == pytest.approx(0.05, abs=0.01)
    assert mean[1] == pytest.approx(0.25, abs=0.03)
    assert mean[2] == pytest.approx(0.4, abs=0.03)
    assert missed <= 10, "of some 200"


def test_every_place_shows_a_jump():
    """A decimated transform sees every other difference only."""
    y = np.random.default_rng(0).normal(0.0, 0.1, 50)
    for place in range(1, 49):
        stepped = y + np.where(np.arange(50) >= place, 5.0, 0.0)
        assert np.flatnonzero(degradation.jump_points(stepped)).tolist() == [place - 1]


def test_without_the_readings_noise_the_diffusion_would_be_that():
    y, where = jumpy(1)
    naive = np.std(np.diff(y)[~where])
    assert naive > 2.0 * degradation.fit(y, np.arange(360.0)).diffusion


def test_a_drift_needs_increments_without_jumps():
    with pytest.raises(ValueError, match="too few"):
        degradation.fit(np.arange(4.0), np.arange(4.0))


@pytest.mark.parametrize("causal", [False, True])
def test_the_method_sees_an_odd_motor_and_causal_means_causal(causal):
    healthy, test = train_record(seed=1), train_record(seed=2)
    odd = test.temperature.copy()
    odd[120:160, 2, 0] += 6.0
    method = PaperMethod(causal=causal)
    score = method.fit(healthy)
    plain, ill = score(test), score(test._replace(temperature=odd))
    assert np.median(ill[125:155]) > 3.0 * np.median(plain)
    assert np.array_equal(ill[:120], plain[:120]) == causal
    turned = test._replace(
        temperature=odd[:, [2, 0, 3, 1]], current_square=test.current_square[:, [2, 0, 3, 1]]
    )
    swapped = healthy._replace(
        temperature=healthy.temperature[:, [2, 0, 3, 1]],
        current_square=healthy.current_square[:, [2, 0, 3, 1]],
    )
    np.testing.assert_allclose(method.fit(swapped)(turned), ill, rtol=1e-6)
