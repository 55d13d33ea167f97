"""The rivals of the thermal method: causal, repeatable, blind to nothing obvious, never raising."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from _traction_core import ffi

from estimators.thermal.record import Record
from estimators.thermal.rivals import RIVALS
from estimators.thermal.rivals.dpca import filled, moving
from estimators.thermal.rivals.dsfa import Slow
from estimators.thermal.rivals.ekf import Lumped, innovations
from gateway.study.thermal_dataset import BASES, BENCH, DAYS, train
from tests.reference import rival_ekf

EARLY = 40
"""Samples by which every rival has its lags or its sequence."""
LENGTH = {"days": 300, "bench": 1500}


@cache
def run(base, number):
    """A healthy run, cut short: inputs, too, end with the last sample."""
    whole = train(3, {"days": DAYS, "bench": BENCH}[base], None, number)
    at = whole.at[: LENGTH[base]]
    steps = int(at[-1]) + 1
    return Record(
        whole.temperature[: len(at)], at, whole.current_square[:steps], whole.speed[:steps],
        whole.ambient[:steps], whole.step_s,
    )  # fmt: skip


@cache
def fitted(name, base):
    return RIVALS[base][name].fit(run(base, 0))


def changed(record, change):
    temperature = record.temperature.copy()
    change(temperature)
    return record._replace(temperature=temperature)


every_rival = pytest.mark.parametrize("name", [
    # It learns for seconds, in NumPy, for a table of comparison.
    pytest.param(name, marks=[pytest.mark.thorough] * (name == "lstm")) for name in RIVALS["days"]
])  # fmt: skip
every_base = pytest.mark.parametrize("base", LENGTH)


def test_the_registry_is_table_2():
    assert list(RIVALS) == list(BASES)
    for rivals in RIVALS.values():
        assert list(rivals) == ["dpca", "dsfa", "lstm", "jitl", "ekf", "ekf_following"]
        assert all(name == method.name for name, method in rivals.items())


@every_rival
@every_base
def test_another_run_is_scored_with_finite_statistics(name, base):
    record = run(base, 1)
    score = fitted(name, base)(record)
    assert score.shape == record.at.shape
    assert np.isfinite(score[EARLY:]).all()
    assert (score[EARLY:] >= 0.0).all()
    early = np.isnan(score)
    assert not (np.diff(early.astype(int)) > 0).any(), "NaN only at the start"


@every_rival
@every_base
def test_later_samples_change_nothing(name, base):
    record, score = run(base, 1), fitted(name, base)
    k = len(record.at) // 2

    def later(temperature):
        temperature[k:] += 50.0
        temperature[k + 5 :, 0] = np.nan

    whole = score(record)
    np.testing.assert_allclose(score(changed(record, later))[:k], whole[:k], rtol=1e-5)
    cut = record._replace(temperature=record.temperature[:k], at=record.at[:k])
    np.testing.assert_allclose(score(cut), whole[:k], rtol=1e-5)


@every_rival
def test_the_same_data_give_the_same_statistic(name):
    again = RIVALS["days"][name].fit(run("days", 0))
    np.testing.assert_array_equal(again(run("days", 1)), fitted(name, "days")(run("days", 1)))


@every_rival
@every_base
def test_thirty_kelvin_on_one_sensor_stand_out(name, base):
    record, score = run(base, 1), fitted(name, base)
    k = len(record.at) // 2
    healthy = score(record)[EARLY:]

    def step(temperature):
        temperature[k:, 2, 1] += 30.0

    after = score(changed(record, step))[k : k + EARLY]
    # The filter follows the step soon: it is enough that it was seen.
    assert after.max() > np.quantile(healthy, 0.999)


@every_rival
@every_base
def test_missing_readings_do_no_harm(name, base):
    record, score = run(base, 1), fitted(name, base)
    rng = np.random.default_rng(5)

    def holes(temperature):
        temperature[rng.random(temperature.shape) < 0.05] = np.nan
        temperature[:3] = np.nan
        temperature[60:80] = np.nan
        temperature[:, 1, 2] = np.nan

    assert np.isfinite(score(changed(record, holes))[EARLY:]).all()
    healthy = changed(run(base, 0), holes)
    assert np.isfinite(RIVALS[base][name].fit(healthy)(record)[EARLY:]).all()


@every_rival
def test_too_short_a_run_is_refused(name):
    record = run("days", 0)
    short = record._replace(temperature=record.temperature[:2], at=record.at[:2])
    with pytest.raises(ValueError, match="too few"):
        RIVALS["days"][name].fit(short)


def test_an_unknown_view_is_refused():
    with pytest.raises(ValueError, match="no view"):
        replace(RIVALS["days"]["dpca"], view="sideways").fit(run("days", 0))


def test_the_last_known_reading_stands_in():
    readings = np.array([np.nan, 1.0, np.nan, np.nan, 4.0])[:, None, None]
    out = filled(readings, np.array([[7.0]]))
    assert out.ravel().tolist() == [7.0, 1.0, 1.0, 1.0, 4.0]


def test_the_moving_mean_looks_back_only():
    assert moving(np.array([1.0, 3.0, 5.0, 7.0]), 2).tolist() == [1.0, 2.0, 4.0, 6.0]
    assert moving(np.array([1.0, 3.0]), 9).tolist() == [1.0, 2.0]


def test_the_slowest_feature_comes_first():
    t = np.arange(2000) * 0.01
    slow, fast = np.sin(t), np.sin(29.0 * t)
    mixed = np.stack([slow + 0.5 * fast, fast - 0.3 * slow], axis=1)
    out = Slow.fit(mixed)(mixed)
    assert abs(np.corrcoef(out[:, 0], slow)[0, 1]) > 0.999
    assert np.allclose(out.std(axis=0), 1.0, atol=1e-3)


def lumped(rng, points):
    return Lumped(
        rng.uniform(1e-7, 4e-7, points), rng.uniform(2e-4, 2e-3, points),
        rng.uniform(0.0, 0.2, points), rng.normal(0.0, 1.0, points),
        rng.uniform(0.1, 2.0, points), rng.uniform(0.05, 0.5, points), np.full(points, 50.0),
    )  # fmt: skip


def recorded(rng, at, steps, step_s, motors=1, missing=0.2):
    """A record with readings about 50 degC."""
    reading = 50.0 + 5.0 * rng.standard_normal((len(at), motors, 3))
    reading[rng.random(reading.shape) < missing] = np.nan
    return Record(
        reading, at, rng.uniform(0.0, 9e4, (steps, motors)), rng.uniform(-300.0, 300.0, steps),
        rng.uniform(10.0, 30.0, steps), step_s,
    )  # fmt: skip


def by_the_reference(record, model, step, prior_sigma):
    reading = record.temperature.reshape(len(record.at), -1)
    out = np.empty_like(reading)
    rival_ekf.innovations(
        reading, record.at, record.current_square, record.speed**2, record.ambient,
        record.step_s, np.stack(model), step, prior_sigma, out,
    )  # fmt: skip
    return out


def test_a_model_is_in_the_order_of_its_record():
    fields = ffi.typeof("struct lumped_model").fields
    assert tuple(name for name, _ in fields) == Lumped._fields


def test_a_gap_is_integrated_exactly():
    """Against ten thousand Euler steps per step; sigma of the innovations is 10 K."""
    rng = np.random.default_rng(1)
    heat, speed, air = rng.random(31), rng.random(31), 20.0 * rng.random(31)
    h = 20.0 / 10_000
    for loss, start in ((2e-3, 50.0), (5e-4, 60.0)):
        reading = np.full((2, 1, 3), np.nan)
        reading[1] = 40.0
        record = Record(reading, np.array([0, 30]), heat[:, None], speed, air, 20.0)
        model = Lumped(*(np.full(3, v) for v in (1.0, loss, 0.3, 0.0, 100.0, 0.0, start)))
        T = start
        for k in range(1, 31):
            end = (heat[k] + 0.3 * speed[k] ** 2) / loss + air[k]
            T = end + (T - end) * (1.0 - h * loss) ** 10_000
        out = innovations(record, model, 0.0, 0.0)
        assert out[0].tolist() == [0.0] * 3
        assert 40.0 - 10.0 * out[1] == pytest.approx(T, abs=1e-3)


def test_with_known_coefficients_the_filter_is_the_kalman_filter():
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(4)
    model, at = lumped(rng, 3), np.arange(3, 400, 4)
    record = recorded(rng, at, 400, 5.0)
    out = innovations(record, model, 0.0, 0.0)
    for n in range(3):
        gain, loss, share, offset, unrest, noise, usual = np.stack(model)[:, n]
        kf = KalmanFilter(dim_x=1, dim_z=1, dim_u=1)
        kf.x[:], kf.P[:], kf.R[:], kf.H[:] = usual - offset, 100.0, noise, 1.0
        kf.B = np.eye(1)
        for k, now in enumerate(at.tolist()):
            if k:
                gone = slice(int(at[k - 1]) + 1, now + 1)
                decay, warmed, aired = rival_ekf.gap(
                    loss, record.current_square[gone, 0], share, record.speed[gone] ** 2,
                    record.ambient[gone], 5.0,
                )  # fmt: skip
                kf.predict(
                    u=np.array([[gain * warmed + aired]]),
                    F=np.array([[decay]]),
                    Q=np.array([[unrest * (1.0 - decay**2)]]),
                )
            want, reading = 0.0, record.temperature[k, 0, n]
            if np.isfinite(reading):
                kf.update(np.array([[reading - offset]]))
                want = kf.y[0, 0] / np.sqrt(kf.S[0, 0])
            assert out[k, n] == pytest.approx(want, abs=1e-9), (k, n)


@pytest.mark.parametrize(
    ("step", "prior_sigma", "samples"),
    [(0.0, 0.0, 200), (1e-6, 1e-3, 200), (1e-4, 0.05, 200), (0.5, 3.0, 10)],
)
def test_the_filter_equals_its_reference(step, prior_sigma, samples):
    """Several motors, gaps of any length, none at all, and coefficients up to their limits.

    The last bits of exp go into a derivative by differences, which large variances multiply from
    sample to sample: ten of them are compared.
    """
    for seed in range(6):
        rng = np.random.default_rng(seed)
        at = np.cumsum(rng.integers(0, 6, samples))
        record = recorded(rng, at, int(at[-1]) + 1, 30.0, motors=2)
        model = lumped(rng, 6)
        got, want = (f(record, model, step, prior_sigma) for f in (innovations, by_the_reference))
        np.testing.assert_allclose(got, want, rtol=1e-7, atol=1e-7)


def test_the_filter_of_a_real_run_equals_its_reference():
    record = changed(run("days", 1), lambda t: t.__setitem__((slice(60, 80), 1, 2), np.nan))
    model = Lumped.of(run("days", 0))
    got, want = (f(record, model, 1e-5, 0.05) for f in (innovations, by_the_reference))
    np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-8)


def test_a_run_without_samples_has_no_innovations():
    rng = np.random.default_rng(3)
    record = recorded(rng, np.array([], dtype=np.int64), 5, 30.0)
    assert innovations(record, lumped(rng, 3), 1e-4, 0.05).shape == (0, 3)


def test_numbers_that_are_none_do_no_harm():
    rng = np.random.default_rng(8)
    odd = [0.0, -1.0, 1e-320, 1e308, -1e308, np.nan, np.inf, -np.inf]
    for _ in range(300):
        at = np.cumsum(rng.integers(0, 4, 12))
        record = recorded(rng, at, int(at[-1]) + 1, 30.0)
        for array in record[:1] + record[2:5]:
            array[rng.random(array.shape) < 0.2] = rng.choice(odd)
        model = Lumped(*(rng.choice([1e-3, *odd], 3) for _ in Lumped._fields))
        out = innovations(record, model, rng.choice(odd), rng.choice(odd))
        assert (out[~np.isfinite(record.temperature.reshape(out.shape))] == 0.0).all()


def test_the_lumped_model_is_found_again():
    """Data from eq. (1) itself give its own coefficients."""
    rng = np.random.default_rng(2)
    steps, step_s, gain, loss = 6000, 10.0, 2e-7, 6e-4
    square = np.repeat(rng.uniform(0.0, 9e4, steps // 60), 60)
    T, course = 20.0, []
    for u in square.tolist():
        end = gain * u / loss + 20.0
        T = end + (T - end) * np.exp(-loss * step_s)
        course.append(T)
    at = np.arange(29, steps, 30)
    reading = np.array(course)[at] + 0.1 * rng.standard_normal(len(at))
    temperature = np.repeat(reading[:, None], 3, axis=1)[:, None, :]
    record = Record(temperature, at, square[:, None], np.zeros(steps), np.full(steps, 20.0), step_s)
    found = Lumped.of(record)
    assert np.allclose(found.loss, loss, rtol=0.15)
    assert np.allclose(found.gain / found.loss, gain / loss, rtol=0.05)
