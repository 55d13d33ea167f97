"""Acquisition: right or not ready, never wrong. 36 start angles, both directions, both buses."""

import math

import numpy as np
import pytest

from estimators import filters
from estimators.models import pmsm
from estimators.models.pmsm import Noise, Rated
from tests.core_calls import acquisition
from tests.core_calls.acquisition import Consistency
from tests.core_calls.filters import sweep
from tests.filter_records import acquire, check, estimate, start_states
from tests.reference import acquisition as reference
from tests.reference import motor_model
from tests.unit.test_est_ekf import bench
from tests.unit.test_est_truth import PSI, TICK_S, Rows, motor, sampled

ANGLES = np.arange(36) * (2.0 * math.pi / 36.0)
W_ON = 20.0


def rated(n):
    return Rated(np.full(n, 25.0), np.full(n, 30.0))


def standing(final, rate, load, ticks=4000):
    """From rest along a speed ramp of `rate` rad/s^2 to `final`, all angles."""
    ref = np.clip(np.arange(ticks) * TICK_S * rate, 0.0, abs(final)) * math.copysign(1.0, final)
    return motor(np.zeros(36), ANGLES, np.tile(ref[:, None], (1, 36)), np.full((ticks, 36), load))


def rolling(w, ticks=2400):
    shape = (ticks, 36)
    return motor(np.full(36, w), ANGLES, np.full(shape, w), np.full(shape, math.copysign(15.0, w)))


def feed(state, par, rows, picked):
    acquire(state, par, [column[picked] for column in rows[:5]], TICK_S)


def watch(truth, rows, par=None):
    """Feed 10 ms at a time; yield (last tick, estimate, state) after each.

    Only drives whose last sample was not lost are comparable with the truth at the tick.
    """
    n = truth.w.shape[1]
    par = par or bench(n)[0]
    state = acquisition.start(n)
    for end in range(80, len(truth.w) + 1, 80):
        picked = (rows.tick >= end - 80) & (rows.tick < end)
        feed(state, par, rows, picked)
        yield end - 1, estimate(state), state


def check_never_wrong(truth, rows, par=None):
    """Assert it; return the time (36,) from passing w_on to the first `ready`, s."""
    first = np.full(36, np.inf)
    passed = np.argmax(np.abs(truth.w) > W_ON, axis=0) * TICK_S
    for tick, found, state in watch(truth, rows, par):
        w, theta, ready = truth.w[tick], truth.theta[tick], found.ready
        # Off at 15 rad/s by a mean over 25 ms: a rotor that brakes hard is below it by then.
        assert (np.abs(w[ready]) > 5.0).all(), "ready at a speed that is not observable"
        assert (np.sign(found.w[ready]) == np.sign(w[ready])).all()
        assert (np.abs(motor_model.wrap(found.theta - theta))[ready] < 0.35).all()
        assert (np.abs(found.w - w)[ready] < 20.0 + 0.5 * np.abs(found.w[ready])).all()
        x = np.zeros((36, 5))
        x[:, 2], x[:, 3] = w, theta
        assert (check(state, x) != Consistency.INCONSISTENT).all()
        first = np.where(ready & np.isinf(first), tick * TICK_S, first)
    return first - passed


@pytest.mark.parametrize("w", [5500.0, -9000.0, 13_400.0, 20_000.0])
def test_faster_than_ten_samples_per_revolution_is_never_ready(w):
    """16,000 rpm with eight pole pairs are 13,400 rad/s; with chords of 2 ms they would alias."""
    truth = rolling(w, ticks=1600)
    for _, found, _ in watch(truth, sampled(truth, 1, 2e-4, seed=1)):
        assert not found.ready.any()


@pytest.mark.parametrize(("begin", "final"), [(100.0, 3300.0), (-3300.0, -400.0)])
def test_chords_change_their_length_without_losing_the_lock(begin, final):
    ticks, rate = 8000, 4000.0
    ref = np.clip(np.arange(ticks) * TICK_S * rate - 0.2 * rate, 0.0, abs(final - begin))
    ref = begin + np.sign(final - begin) * ref
    shape = (ticks, 36)
    truth = motor(np.full(36, begin), ANGLES, np.tile(ref[:, None], (1, 36)), np.zeros(shape))
    rows = sampled(truth, 1, 2e-4, seed=12)
    lengths = set()
    for tick, found, state in watch(truth, rows):
        lengths |= set(state.stride.tolist())
        assert found.ready.all() or tick < 800, tick
        assert (
            np.abs(motor_model.wrap(found.theta - truth.theta[tick])) < 0.35
        ).all() or tick < 800
    assert len(lengths) >= 4
    check_never_wrong(truth, rows)


def test_a_long_hole_begins_with_the_shortest_chord_again():
    """Nobody knows how fast a rotor turns after it: 2 ms might alias."""
    slow, fast = rolling(50.0, ticks=1600), rolling(4000.0, ticks=1600)
    par, _ = bench(36)
    state = acquisition.start(36)
    rows = sampled(slow, 1, 2e-4, seed=13)
    feed(state, par, rows, np.ones(len(rows.drive), dtype=np.bool_))
    assert (state.stride == 16).all()
    rows = sampled(fast, 1, 2e-4, seed=14)
    rows = rows._replace(n_gap=np.where(rows.tick == 0, 400, 0))
    feed(state, par, rows, rows.tick < 40)
    assert not state.ready.any()
    feed(state, par, rows, rows.tick >= 40)
    found = estimate(state)
    assert found.ready.all()
    assert found.w == pytest.approx(fast.w[-1], rel=0.01)


@pytest.mark.parametrize("wrong", [{"R_s": 1.2}, {"R_s": 0.8}, {"psi_f": 1.2, "L_s": 0.8}])
@pytest.mark.parametrize("every", [16, 1])
def test_wrong_constants_and_lost_samples(wrong, every):
    par, _ = bench(36)
    par = par._replace(**{name: getattr(par, name) * factor for name, factor in wrong.items()})
    truth = standing(-150.0, 800.0, -20.0)
    delay = check_never_wrong(truth, sampled(truth, every, 2e-4, seed=3, lost=0.01), par)
    assert (delay < 0.3).all()


@pytest.mark.parametrize("rate", [100.0, 1000.0, 2500.0])
@pytest.mark.parametrize("every", [16, 1])
def test_reversal_through_zero(every, rate):
    """Never ready with the old direction after the turn."""
    ref = np.clip(80.0 - (np.arange(8000) * TICK_S - 0.1) * rate, -80.0, 80.0)
    shape = (8000, 36)
    load = np.zeros(shape)
    truth = motor(np.full(36, 80.0), ANGLES, np.tile(ref[:, None], (1, 36)), load)
    assert (truth.w.min() < -25.0) or rate == 100.0
    check_never_wrong(truth, sampled(truth, every, 1e-2, seed=11))


def test_standstill_and_crawl_are_never_ready():
    ticks = 4000
    w = np.linspace(-10.0, 10.0, 36)
    truth = motor(w, ANGLES, np.tile(w, (ticks, 1)), np.zeros((ticks, 36)))
    for _, found, state in watch(truth, sampled(truth, 16, 1e-2, seed=4)):
        assert not found.ready.any()
        x = np.zeros((36, 5))
        assert (check(state, x) == Consistency.UNKNOWN).all()


def test_a_runaway_filter_at_standstill_is_noticed():
    ticks = 1600
    truth = motor(np.zeros(36), ANGLES, np.zeros((ticks, 36)), np.zeros((ticks, 36)))
    for _, _, state in watch(truth, sampled(truth, 16, 2e-4, seed=5)):
        x = np.zeros((36, 5))
        x[:, 2] = -80.0
        verdict = check(state, x)
    assert (verdict == Consistency.INCONSISTENT).all()


@pytest.mark.parametrize("every", [16, 1])
@pytest.mark.parametrize("final", [100.0, -250.0])
def test_agreement_tells_right_from_wrong_filters(final, every):
    """With the paper's Q half of all start angles end in the wrong state: all are found."""
    truth = standing(final, 500.0, math.copysign(10.0, final), ticks=8000)
    rows = sampled(truth, every, 2e-4, seed=6)
    par, noise = bench(36)
    paper = Noise(np.tile([0.05, 0.05, 1e-3, 1e-4, 0.1], (36, 1)), noise.R, noise.coast)
    x = np.zeros((36, 5))
    P = np.tile(np.diag([1.0, 1.0, 1e4, 4.0, 900.0]), (36, 1, 1))
    sweep("ekf", pmsm.table(par), paper, x, P, filters.sample_records(*rows[:5]), TICK_S)
    state = acquisition.start(36)
    feed(state, par, rows, np.ones(len(rows.drive), dtype=np.bool_))
    error = np.abs(motor_model.wrap(x[:, 3] - truth.theta[-1]))
    right = error < 0.3
    assert (error[~right] > 2.0).all()
    assert 9 <= np.count_nonzero(right) <= 27
    verdict = check(state, x)
    assert (verdict[right] == Consistency.CONSISTENT).all()
    assert (verdict[~right] == Consistency.INCONSISTENT).all()


def test_chords_of_known_motion():
    """Exact volt-seconds of a rotor at constant speed, no load: the law of the chord itself."""
    w, span = 120.0, 16 * TICK_S
    theta = 0.4 + w * span * np.arange(41)
    volt_seconds = PSI * np.diff(np.exp(1j * theta))
    u = volt_seconds / span
    state = acquisition.start(1)
    par, _ = bench(1)
    rows = Rows(
        np.zeros(40, dtype=np.int32),
        np.stack([u.real, u.imag], axis=1),
        np.zeros((40, 2)),
        np.full(40, 16, dtype=np.int64),
        np.zeros(40, dtype=np.int64),
        np.arange(40),
    )
    feed(state, par, rows, np.ones(40, dtype=np.bool_))
    ready, w_hat, theta_hat, spread = estimate(state)
    assert ready.all()
    assert w_hat == pytest.approx([w], rel=1e-12)
    assert motor_model.wrap(theta_hat - theta[-1]) == pytest.approx([0.0], abs=1e-12)
    assert spread == pytest.approx([0.0], abs=1e-6)
    assert state.psi == pytest.approx([PSI], rel=1e-12)
    # Twice per revolution and faster reads as the other direction: documented, not hidden.
    assert abs(w * span) < 2.5 < math.pi


def test_a_hole_breaks_pairs_and_a_long_one_the_lock():
    truth = rolling(100.0)
    rows = sampled(truth, 16, 2e-4, seed=8)
    par, _ = bench(36)
    state = acquisition.start(36)
    feed(state, par, rows, rows.tick < 1600)
    assert state.ready.all()
    pairs = state.pairs.copy()
    short = rows._replace(n_gap=np.where(rows.tick == 1679, 64, 0))
    feed(state, par, short, (rows.tick > 1664) & (rows.tick < 1712))
    assert state.ready.all()
    # 1679 starts a chord, 1695 ends the first, 1711 the second: one pair.
    assert (state.pairs == pairs + 1).all()
    long = rows._replace(n_gap=np.where(rows.tick == 1999, 400, 0))
    feed(state, par, long, rows.tick == 1999)
    assert not state.ready.any()


def test_bad_numbers_neither_raise_nor_stay():
    truth = rolling(100.0)
    rows = sampled(truth, 16, 2e-4, seed=9)
    y = rows.y.copy()
    y[rows.tick == 799] = np.nan
    y[rows.tick == 815] = 1e200
    par, _ = bench(36)
    state = acquisition.start(36)
    feed(state, par, rows._replace(y=y), rows.tick < 900)
    feed(state, par, rows, rows.tick >= 900)
    assert state.ready.all()
    assert np.isfinite(state.w).all()


def test_a_restart_is_of_one_drive():
    truth = rolling(100.0)
    rows = sampled(truth, 16, 2e-4, seed=10)
    par, _ = bench(36)
    state = acquisition.start(36)
    feed(state, par, rows, rows.tick < 1600)
    acquisition.restart(state, 5)
    assert not state.ready[5]
    assert np.count_nonzero(state.ready) == 35
    assert state[5].tobytes() == acquisition.start(1)[0].tobytes()


def test_a_filter_of_which_any_number_has_diverged_disagrees():
    x = np.zeros((6, 5))
    x[range(5), range(5)] = np.nan
    wanted = [*[Consistency.INCONSISTENT] * 5, Consistency.UNKNOWN]
    assert check(acquisition.start(6), x).tolist() == wanted


@pytest.mark.parametrize(("beyond", "verdicts"), [(False, "CCU"), (True, "III")])
def test_on_its_limits_a_filter_is_consistent(beyond, verdicts):
    """Speed: 20 rad/s and half of the chords'; angle: 0.8 rad; not ready: 40 rad/s above w_max."""
    state = acquisition.start(3)
    state.ready, state.pairs, state.w, state.w_max = [1, 1, 0], 20, 100.0, 10.0
    x = np.zeros((3, 5))
    x[:, 2], x[1, 3] = [170.0, 100.0, -50.0], 0.8
    x *= 1.0 + 1e-15 * beyond
    assert [v.name[0] for v in map(Consistency, check(state, x))] == list(verdicts)


def constant(m, steps, u):
    """Rows of one drive, a voltage and no current."""
    voltage = np.tile([u.real, u.imag], (m, 1))
    return [np.zeros(m, int), voltage, np.zeros((m, 2)), np.full(m, steps), np.zeros(m, int)]


def test_no_chord_has_no_direction_and_is_never_ready():
    state, par = acquisition.start(1), bench(1)[0]
    acquire(state, par, constant(60, 16, 0j), TICK_S)
    assert (state.pairs[0], state.ready[0]) == (58, 0)
    assert (state.w[0], state.theta[0]) == (0.0, -0.5 * math.pi), "of both directions the positive"
    assert check(state, np.array([[0.0, 0.0, 80.0, 0.0, 0.0]])) == Consistency.INCONSISTENT


def test_the_longest_chord_that_a_flux_explains_bounds_no_speed():
    """Of 2 ms and 1 V; 35 % of a length are tolerance."""
    par = bench(1)[0]
    psi_f = 0.5 * 16 * TICK_S / (1.0 - 0.35)
    for flux, w_max in ((psi_f, math.inf), (np.nextafter(psi_f, 1.0), math.pi / (16 * TICK_S))):
        state = acquisition.start(1)
        acquire(state, par._replace(psi_f=np.full(1, flux)), constant(3, 16, 1.0 + 0j), TICK_S)
        assert state.w_max[0] == pytest.approx(w_max, rel=1e-6)


@pytest.mark.parametrize(("L_s", "power"), [(1e200, 2), (9e153, 1)])
def test_constants_beyond_any_motor_overflow_a_mean_and_it_starts_anew(L_s, power):
    """Each mean, or only their sum."""
    state, par = acquisition.start(1), bench(1)[0]
    huge = par._replace(L_s=np.full(1, L_s))
    rows = constant(6, 16, 1.0 + 0j)
    rows[2][:, 0] = np.arange(6.0) ** power
    acquire(state, huge, rows, TICK_S)
    assert (state.pairs[0], state.ready[0]) == (0, 0)
    acquire(state, par, constant(40, 16, 1.0 + 0j), TICK_S)
    assert state.pairs[0] > 30
    assert np.isfinite(state.S0[0])


def test_chords_of_another_length_start_anew():
    """Not half or twice as long: 0.75 ms after 2 ms."""
    rows, par = sampled(rolling(100.0), 16, 2e-4, seed=16), bench(36)[0]
    state = acquisition.start(36)
    feed(state, par, rows, rows.tick < 1600)
    assert state.ready.all()
    state.stride = 1
    short = rows._replace(n_sub=np.full(len(rows.drive), 6))
    feed(state, par, short, (rows.tick >= 1600) & (rows.tick < 1664))
    assert not state.ready.any()
    assert (state.pairs < 4).all()


def test_it_equals_the_reference():
    """Random motion, gaps, implausible and extreme samples, and short and long ones."""
    ticks = 2400
    start_w, load = np.array([60.0, -90.0, 0.0, 1500.0]), np.zeros((ticks, 4))
    ref = np.cumsum(np.random.default_rng(1).normal(0.0, 3.0, (ticks, 4)), axis=0) + start_w
    truth = motor(start_w, np.arange(4.0), ref, load)
    par, noise = bench(4)
    for every, seed in ((16, 2), (1, 3), (4, 4)):
        rows = sampled(truth, every, 1e-2, seed, lost=0.02)
        rng = np.random.default_rng(seed)
        y, gap = rows.y.copy(), rows.n_gap.copy()
        y[rng.integers(0, len(y), 6), 0] = [np.nan, np.inf, -1e300, 1e5, 9e4, 0.0]
        gap[rng.integers(0, len(y), 5)] = [1, 100, 400, 10_000, 1 << 40]
        state, plain = acquisition.start(4), acquisition.start(4)
        args = (rows.drive, rows.u, y, rows.n_sub, gap)
        for k in range(0, len(y), 100):
            part = [column[k : k + 100] for column in args]
            acquire(state, par, part, TICK_S)
            reference.add(pmsm.table(par), plain, reference.Tuning(), *part, TICK_S)
            for name in state.dtype.names:
                np.testing.assert_allclose(
                    state[name], plain[name], rtol=1e-7, atol=1e-9, err_msg=name
                )
        assert state.ready.any()
        wanted = reference.start_states(plain, par, noise, rated(4))
        for got, want in zip(start_states(state, par, noise, rated(4)), wanted, strict=True):
            np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-9)


def test_the_check_equals_the_reference():
    rng = np.random.default_rng(5)
    n = 400
    state = acquisition.start(n)
    state.w, state.theta = rng.uniform(-200, 200, n), rng.uniform(-4, 4, n)
    state.age, state.ready = rng.uniform(0, 0.01, n), rng.random(n) < 0.7
    state.pairs, state.w_max = rng.integers(0, 40, n), rng.uniform(0, 100, n)
    x = rng.normal(size=(n, 5))
    x[:, 2] = state.w + rng.normal(scale=20, size=n)
    x[:, 3] = state.theta + rng.normal(scale=0.5, size=n)
    x[::17] = np.nan
    assert check(state, x).tolist() == reference.check(state, x)
    assert set(check(state, x).tolist()) == set(Consistency)
