"""The lock: right or not ready, never wrong. 36 start angles, both directions, both buses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators import _lanes_kernels, _lock_kernels, lock
from estimators._lanes import lanes_room
from estimators.lock import Agreement
from estimators.models import pmsm
from estimators.models.pmsm import Noise, Pmsm, Rated
from tests.unit.test_est_ekf import bench
from tests.unit.test_est_truth import PSI, TICK_S, Rows, Truth, motor, sampled

ANGLES = np.arange(36) * (2.0 * math.pi / 36.0)
TUNING = lock.LockTuning()


def rated(n: int) -> Rated:
    return Rated(np.full(n, 25.0), np.full(n, 30.0))


def standing(final: float, rate: float, load: float, ticks: int = 4000) -> Truth:
    """From rest along a speed ramp of `rate` rad/s^2 to `final`, all angles."""
    ref = np.clip(np.arange(ticks) * TICK_S * rate, 0.0, abs(final)) * math.copysign(1.0, final)
    return motor(np.zeros(36), ANGLES, np.tile(ref[:, None], (1, 36)), np.full((ticks, 36), load))


def rolling(w: float, ticks: int = 2400) -> Truth:
    shape = (ticks, 36)
    return motor(np.full(36, w), ANGLES, np.full(shape, w), np.full(shape, math.copysign(15.0, w)))


def feed(state: lock.LockState, par: Pmsm, rows: Rows, picked: np.ndarray) -> None:
    _lock_kernels.lock_sweep(
        pmsm.table(par), state, TUNING, *(column[picked] for column in rows[:5]), TICK_S
    )


def watch(truth: Truth, rows: Rows, par: Pmsm | None = None):
    """Feed 10 ms at a time; yield (last tick, estimate, state) after each.

    Only drives whose last sample was not lost are comparable with the truth at the tick.
    """
    n = truth.w.shape[1]
    par = par or bench(n)[0]
    state = lock.start(n)
    for end in range(80, len(truth.w) + 1, 80):
        picked = (rows.tick >= end - 80) & (rows.tick < end)
        feed(state, par, rows, picked)
        yield end - 1, lock.lock_estimate(state), state


def check_never_wrong(truth: Truth, rows: Rows, par: Pmsm | None = None) -> np.ndarray:
    """Assert it; return the time (36,) from passing w_on to the first `ready`, s."""
    first = np.full(36, np.inf)
    passed = np.argmax(np.abs(truth.w) > TUNING.w_on, axis=0) * TICK_S
    for tick, estimate, state in watch(truth, rows, par):
        w, theta, ready = truth.w[tick], truth.theta[tick], estimate.ready
        # Off at 15 rad/s by a mean over 25 ms: a rotor that brakes hard is below it by then.
        assert (np.abs(w[ready]) > 5.0).all(), "ready at a speed that is not observable"
        assert (np.sign(estimate.w[ready]) == np.sign(w[ready])).all()
        assert (np.abs(pmsm.wrap(estimate.theta - theta))[ready] < 0.35).all()
        assert (np.abs(estimate.w - w)[ready] < 20.0 + 0.5 * np.abs(estimate.w[ready])).all()
        x = np.zeros((36, 5))
        x[:, 2], x[:, 3] = w, theta
        assert (lock.agrees(state, x, TUNING) != Agreement.DISAGREES).all()
        first = np.where(ready & np.isinf(first), tick * TICK_S, first)
    return first - passed


@pytest.mark.parametrize("noise_var", [2e-4, 1e-2])
@pytest.mark.parametrize("every", [16, 1])
@pytest.mark.parametrize("w", [25.0, -40.0, 100.0, -200.0, 300.0])
def test_rolling_start(w, every, noise_var):
    truth = rolling(w)
    delay = check_never_wrong(truth, sampled(truth, every, noise_var, seed=1))
    assert (delay < (0.3 if abs(w) < 50.0 else 0.06)).all()


@pytest.mark.parametrize(
    ("w", "every"),
    [(600.0, 16), (-1200.0, 16), (600.0, 1), (-1200.0, 1), (2000.0, 1), (-3500.0, 1), (4900.0, 1)],
)
def test_rolling_start_at_speed(w, every):
    """The chord is as short as the speed asks for, down to a sample."""
    truth = rolling(w)
    delay = check_never_wrong(truth, sampled(truth, every, 2e-4, seed=1))
    assert (delay < 0.06).all()


@pytest.mark.parametrize("w", [5500.0, -9000.0, 13_400.0, 20_000.0])
def test_faster_than_ten_samples_per_revolution_is_never_ready(w):
    """16,000 rpm with eight pole pairs are 13,400 rad/s; with chords of 2 ms they would alias."""
    truth = rolling(w, ticks=1600)
    for _, estimate, _ in watch(truth, sampled(truth, 1, 2e-4, seed=1)):
        assert not estimate.ready.any()


@pytest.mark.parametrize(("begin", "final"), [(100.0, 3300.0), (-3300.0, -400.0)])
def test_chords_change_their_length_without_losing_the_lock(begin, final):
    ticks, rate = 8000, 4000.0
    ref = np.clip(np.arange(ticks) * TICK_S * rate - 0.2 * rate, 0.0, abs(final - begin))
    ref = begin + np.sign(final - begin) * ref
    shape = (ticks, 36)
    truth = motor(np.full(36, begin), ANGLES, np.tile(ref[:, None], (1, 36)), np.zeros(shape))
    rows = sampled(truth, 1, 2e-4, seed=12)
    lengths = set()
    for tick, estimate, state in watch(truth, rows):
        lengths |= set(state.stride.tolist())
        assert estimate.ready.all() or tick < 800, tick
        assert (np.abs(pmsm.wrap(estimate.theta - truth.theta[tick])) < 0.35).all() or tick < 800
    assert len(lengths) >= 4
    check_never_wrong(truth, rows)


def test_a_long_hole_begins_with_the_shortest_chord_again():
    """Nobody knows how fast a rotor turns after it: 2 ms might alias."""
    slow, fast = rolling(50.0, ticks=1600), rolling(4000.0, ticks=1600)
    par, _ = bench(36)
    state = lock.start(36)
    rows = sampled(slow, 1, 2e-4, seed=13)
    feed(state, par, rows, np.ones(len(rows.drive), dtype=np.bool_))
    assert (state.stride == 16).all()
    rows = sampled(fast, 1, 2e-4, seed=14)
    rows = rows._replace(n_gap=np.where(rows.tick == 0, 400, 0))
    feed(state, par, rows, rows.tick < 40)
    assert not state.ready.any()
    feed(state, par, rows, rows.tick >= 40)
    estimate = lock.lock_estimate(state)
    assert estimate.ready.all()
    assert estimate.w == pytest.approx(fast.w[-1], rel=0.01)


@pytest.mark.parametrize("noise_var", [2e-4, 1e-2])
@pytest.mark.parametrize("every", [16, 1])
@pytest.mark.parametrize(
    ("final", "rate", "load"), [(100, 500, 10), (-200, 5000, -5), (300, 200, 20), (-120, 3000, 20)]
)
def test_standing_start(final, rate, load, every, noise_var):
    truth = standing(final, rate, load)
    delay = check_never_wrong(truth, sampled(truth, every, noise_var, seed=2))
    assert (delay < 0.3).all()


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
    for _, estimate, state in watch(truth, sampled(truth, 16, 1e-2, seed=4)):
        assert not estimate.ready.any()
        x = np.zeros((36, 5))
        assert (lock.agrees(state, x) == Agreement.UNKNOWN).all()


def test_a_runaway_filter_at_standstill_is_noticed():
    ticks = 1600
    truth = motor(np.zeros(36), ANGLES, np.zeros((ticks, 36)), np.zeros((ticks, 36)))
    for _, _, state in watch(truth, sampled(truth, 16, 2e-4, seed=5)):
        x = np.zeros((36, 5))
        x[:, 2] = -80.0
        verdict = lock.agrees(state, x)
    assert (verdict == Agreement.DISAGREES).all()


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
    nis, ok = np.empty(len(rows.drive)), np.empty(36, dtype=np.bool_)
    head = (pmsm.table(par), paper.Q, paper.R, paper.coast)
    _lanes_kernels.ekf_lanes(*head, x, P, *rows[:5], TICK_S, nis, ok, np.zeros(36), lanes_room(36))
    state = lock.start(36)
    feed(state, par, rows, np.ones(len(rows.drive), dtype=np.bool_))
    error = np.abs(pmsm.wrap(x[:, 3] - truth.theta[-1]))
    right = error < 0.3
    assert (error[~right] > 2.0).all()
    assert 9 <= np.count_nonzero(right) <= 27
    verdict = lock.agrees(state, x)
    assert (verdict[right] == Agreement.AGREES).all()
    assert (verdict[~right] == Agreement.DISAGREES).all()


def test_start_state_starts_the_filter_right():
    truth = standing(120.0, 600.0, 15.0, ticks=8000)
    rows = sampled(truth, 16, 2e-4, seed=7)
    par, noise = bench(36)
    state = lock.start(36)
    middle = 4000
    feed(state, par, rows, rows.tick < middle)
    x, P = lock.start_state(state, par, noise, rated(36))
    assert state.ready.all()
    error = np.stack(
        [x[:, 2] - truth.w[middle - 1], pmsm.wrap(x[:, 3] - truth.theta[middle - 1])], axis=1
    )
    deviation = np.sqrt(np.stack([P[:, 2, 2], P[:, 3, 3]], axis=1))
    assert (np.abs(error) < 3.0 * deviation).all()
    late = rows.tick >= middle
    nis, ok = np.empty(np.count_nonzero(late)), np.empty(36, dtype=np.bool_)
    head = (pmsm.table(par), noise.Q, noise.R, noise.coast)
    _lanes_kernels.ekf_lanes(
        *head,
        x,
        P,
        *(column[late] for column in rows[:5]),
        TICK_S,
        nis,
        ok,
        np.zeros(36),
        lanes_room(36),
    )
    assert ok.all()
    assert np.abs(x[:, 4] - 15.0).max() < 2.0
    assert np.abs(pmsm.wrap(x[:, 3] - truth.theta[-1])).max() < 0.05


def test_chords_of_known_motion():
    """Exact volt-seconds of a rotor at constant speed, no load: the law of the chord itself."""
    w, span = 120.0, 16 * TICK_S
    theta = 0.4 + w * span * np.arange(41)
    volt_seconds = PSI * np.diff(np.exp(1j * theta))
    u = volt_seconds / span
    state = lock.start(1)
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
    ready, w_hat, theta_hat, spread = lock.lock_estimate(state)
    assert ready.all()
    assert w_hat == pytest.approx([w], rel=1e-12)
    assert pmsm.wrap(theta_hat - theta[-1]) == pytest.approx([0.0], abs=1e-12)
    assert spread == pytest.approx([0.0], abs=1e-6)
    assert state.psi == pytest.approx([PSI], rel=1e-12)
    # Twice per revolution and faster reads as the other direction: documented, not hidden.
    assert abs(w * span) < TUNING.turn_max < math.pi


def test_a_hole_breaks_pairs_and_a_long_one_the_lock():
    truth = rolling(100.0)
    rows = sampled(truth, 16, 2e-4, seed=8)
    par, _ = bench(36)
    state = lock.start(36)
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
    state = lock.start(36)
    feed(state, par, rows._replace(y=y), rows.tick < 900)
    feed(state, par, rows, rows.tick >= 900)
    assert state.ready.all()
    assert np.isfinite(state.w).all()


def test_forget_starts_one_drive_anew():
    truth = rolling(100.0)
    rows = sampled(truth, 16, 2e-4, seed=10)
    par, _ = bench(36)
    state = lock.start(36)
    feed(state, par, rows, rows.tick < 1600)
    lock.forget(state, 5)
    assert not state.ready[5]
    assert np.count_nonzero(state.ready) == 35
    for old, new in zip(state, lock.start(1), strict=True):
        np.testing.assert_equal(old[5], new[0])


def test_a_diverged_state_disagrees():
    x = np.zeros((2, 5))
    x[1, 4] = np.nan
    assert lock.agrees(lock.start(2), x).tolist() == [Agreement.UNKNOWN, Agreement.DISAGREES]
