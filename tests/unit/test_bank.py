"""The bank on samples of a true motor: what it does about holes, doubts and high speeds."""

import math

import numpy as np
import pytest

from gateway.core.codes import Health
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Estimator
from tests.estimates import step
from tests.sample_rows import Samples
from tests.stations import Bank
from tests.unit.test_est_truth import TICK_S, Rows, motor, sampled

TICK = 80
"""Sub-steps in 10 ms."""
LONGEST_GAP = 64
"""Sub-steps that a filter predicts, `gateway/core/estimate.c`."""


def bank(n, every=16, **config):
    return Bank([BENCH_MOTOR] * n, Estimator(**config), 0.02 if every >= 16 else 0.05)


def steady(w, load, n=2, seconds=0.6):
    shape = (round(seconds / TICK_S), n)
    angles = np.linspace(-3.0, 3.0, n)
    return motor(np.full(n, w), angles, np.full(shape, w), np.full(shape, load))


def without(rows, lost):
    """The rows but for those where `lost` (M,); the gap of the next row of the drive grows."""
    gap = rows.n_gap.copy()
    for d in np.unique(rows.drive):
        missing = 0
        for k in np.flatnonzero(rows.drive == d):
            if lost[k]:
                missing += gap[k] + rows.n_sub[k]
            else:
                gap[k] += missing
                missing = 0
    return Rows(*(column[~lost] for column in rows._replace(n_gap=gap)))


def advance(filters, rows, end, fresh=True):
    """One tick that ends with sub-step `end`."""
    now = slice(*np.searchsorted(rows.tick, [end - TICK, end]))
    n = len(filters.x)
    picked = Samples(*(column[now] for column in rows[:5]))
    heard = [fresh and bool((picked.drive == k).any()) for k in range(n)]
    return step(filters, picked, heard, end * 125_000)


def run(filters, truth, rows):
    """(estimates, true load) of every tick."""
    for end in range(TICK, len(truth.w) + 1, TICK):
        yield end, advance(filters, rows, end), truth.load[end - 1]


def healths(filters, truth, rows):
    return [[e.health for e in estimates] for _, estimates, _ in run(filters, truth, rows)]


def hole(rows, begin, steps, drive=0):
    inside = (rows.tick >= begin) & (rows.tick < begin + steps) & (rows.drive == drive)
    return without(rows, inside)


@pytest.mark.parametrize("every", [16, 1])
def test_a_short_hole_costs_nothing_a_long_one_the_time_to_begin_anew(every):
    truth = steady(100.0, 15.0)
    rows = sampled(truth, every, 2e-4, seed=1)
    begin = 40 * TICK - 2 * LONGEST_GAP
    short = healths(bank(2, every), truth, hole(rows, begin, LONGEST_GAP))
    assert all(tick == [Health.TRACKING] * 2 for tick in short[20:])
    long = healths(bank(2, every), truth, hole(rows, begin, LONGEST_GAP + 16))
    after = [tick[0] for tick in long[39:]]
    assert after[0] is Health.CONVERGING
    assert Health.DIVERGED not in after
    assert after[-1] is Health.TRACKING
    assert all(tick[1] is Health.TRACKING for tick in long[20:]), "the other drive does not notice"


def test_a_single_sample_is_bridged_on_a_slow_bus_too():
    truth = steady(50.0, 15.0, seconds=1.5)
    rows = sampled(truth, 80, 2e-4, seed=1)
    said = healths(bank(2, 80), truth, hole(rows, 100 * TICK, 80))
    doubtful = [k for k, tick in enumerate(said[60:], start=60) if tick[0] is Health.CONVERGING]
    assert set(doubtful) <= {101}, "until the next sample at most, not from anew"


def test_a_load_that_was_moving_is_not_held_through_silence():
    truth = steady(100.0, 15.0)
    rows = sampled(truth, 16, 2e-4, seed=7)
    for jump, health in ((0.0, Health.TRACKING), (4.0, Health.PREDICTING)):
        filters = bank(2)
        for end in range(TICK, 30 * TICK + 1, TICK):
            advance(filters, rows, end)
        filters.tracks.load_change_nm[0] += jump
        nothing = Samples(*(column[:0] for column in rows[:5]))
        said = step(filters, nothing, [True, True], 31 * TICK * 125_000)
        assert [e.health for e in said] == [health, Health.TRACKING]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("every", [16, 1])
def test_after_random_holes_what_is_tracked_is_right(every, kind):
    """Bursts of up to 200 ms: unknown, but never a load that is wrong, and never diverged."""
    n, ticks = 6, 24_000
    rng = np.random.default_rng(3)
    w = rng.uniform(40.0, 250.0, n) * rng.choice([-1.0, 1.0], n)
    ref = w + 0.3 * w * np.sin(np.arange(ticks)[:, None] * TICK_S * 3.0)
    load = np.copysign(rng.uniform(8.0, 25.0, n), w) * np.ones((ticks, 1))
    truth = motor(w, rng.uniform(-3.0, 3.0, n), ref, load)
    rows = sampled(truth, every, 2e-4, seed=4)
    lost = np.zeros(len(rows.drive), dtype=np.bool_)
    for d in range(n):
        for begin in rng.uniform(1000.0, ticks, 12):
            length = math.exp(rng.uniform(math.log(16.0), math.log(1600.0)))
            lost |= (rows.drive == d) & (rows.tick >= begin) & (rows.tick < begin + length)
    filters = bank(n, every, kind=kind)
    tracked = 0
    for end, estimates, true_load in run(filters, truth, without(rows, lost)):
        for d, estimate in enumerate(estimates):
            assert estimate.health is not Health.DIVERGED
            if estimate.health is Health.TRACKING:
                tracked += 1
                assert estimate.load_nm == pytest.approx(true_load[d], abs=2.5), (d, end)
    assert tracked > 0.3 * n * ticks / TICK


@pytest.mark.parametrize("doubt", ["angle", "sigma"])
def test_a_doubt_silences_at_once(doubt):
    """A tick of contradiction is no divergence yet, but no evidence; nor is a load hardly known."""
    truth = steady(100.0, 15.0)
    rows = sampled(truth, 16, 2e-4, seed=2)
    filters = bank(2)
    for end in range(TICK, 30 * TICK + 1, TICK):
        before = advance(filters, rows, end)
    assert [e.health for e in before] == [Health.TRACKING] * 2
    if doubt == "angle":
        filters.x[0, 3] += 2.5
    else:
        filters.tracks.best_sigma_nm[0] *= 0.4
    after = advance(filters, rows, 31 * TICK)
    assert [e.health for e in after] == [Health.CONVERGING, Health.TRACKING]


def stepped(kind, change, rows=None):
    """(health, error of the load) of drive 0 by tick, from the one on before which it is changed.

    change: of the filters, after 30 ticks of tracking.
    """
    truth = steady(100.0, 15.0, seconds=1.0)
    filters, told = bank(2, kind=kind), []
    rows = sampled(truth, 16, 2e-4, seed=2) if rows is None else rows
    for end in range(TICK, 90 * TICK + 1, TICK):
        mine, other = advance(filters, rows, end)
        if end > 30 * TICK:
            off = None if mine.load_nm is None else abs(mine.load_nm - 15.0)
            told.append((mine.health, off))
            assert other.health is Health.TRACKING, "the other drive does not notice"
        if end == 30 * TICK:
            assert mine.health is Health.TRACKING
            change(filters)
    return told


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("by", [2.5, -2.5, 3.1])
def test_a_filter_on_a_wrong_angle_diverges_and_begins_anew(kind, by):
    """Never evidence meanwhile; said in the third tick, right again within 300 ms."""

    def turn(filters):
        filters.x[0, 3] += by

    told = stepped(kind, turn)
    health = [health for health, _ in told]
    assert health[:3] == [Health.CONVERGING] * 2 + [Health.DIVERGED]
    again = health.index(Health.TRACKING)
    assert again < 30
    assert set(health[again:]) == {Health.TRACKING}
    assert set(health[:again]) == {Health.CONVERGING, Health.DIVERGED}
    assert max(off for _, off in told[again:]) < 2.5


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize(
    ("column", "by"), [(3, 0.6), (3, 1.2), (2, 100.0), (2, -400.0), (2, 400.0), (4, 60.0)]
)
def test_a_smaller_error_is_filtered_out_at_once(kind, column, by):
    """Angle (rad), speed (rad/s) or load (Nm): gone in the third tick, no reset is needed."""

    def move(filters):
        filters.x[0, column] += by

    told = stepped(kind, move)
    assert {health for health, _ in told} == {Health.TRACKING}
    assert max(off for _, off in told[2:]) < 2.5


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("blind", ["noise", "turned"])
def test_currents_that_are_none_are_never_tracked(kind, blind):
    """Of a sensor that is blind, or connected the wrong way round."""
    rows = sampled(steady(100.0, 15.0, seconds=1.0), 16, 2e-4, seed=2)
    lost = (rows.drive == 0) & (rows.tick >= 30 * TICK)
    noise = np.random.default_rng(1).normal(0.0, 10.0, rows.y.shape)
    wrong = noise if blind == "noise" else -rows.y
    rows = rows._replace(y=np.where(lost[:, None], wrong, rows.y))
    assert {health for health, _ in stepped(kind, lambda _: None, rows)} <= {
        Health.CONVERGING, Health.DIVERGED
    }  # fmt: skip


@pytest.mark.parametrize("w", [2000.0, -3500.0, 5000.0])
def test_fast_drives_on_the_fast_bus(w):
    """Ten samples per revolution: tracked, the load within a tenth."""
    truth = steady(w, math.copysign(15.0, w))
    last = list(run(bank(2, 1), truth, sampled(truth, 1, 2e-4, seed=5)))[-20:]
    for _, estimates, load in last:
        for estimate in estimates:
            assert estimate.health is Health.TRACKING
            assert estimate.load_nm == pytest.approx(load[0], abs=3.0)
    mean = np.mean([e.load_nm for _, estimates, _ in last for e in estimates])
    assert mean == pytest.approx(math.copysign(15.0, w), rel=0.1)


def test_faster_than_sampling_allows_is_unknown():
    truth = steady(6000.0, 15.0)
    said = healths(bank(2, 1), truth, sampled(truth, 1, 2e-4, seed=5))
    assert {health for tick in said for health in tick} == {Health.CONVERGING}


def test_what_the_lock_forgets_the_filter_begins_anew():
    """Many short holes: the chords lose their memory, and with them the angle its witness."""
    truth = steady(100.0, 15.0)
    rows = sampled(truth, 16, 2e-4, seed=6)
    thin = without(rows, (rows.drive == 0) & (rows.tick > 2400) & (rows.tick // 16 % 2 == 0))
    said = healths(bank(2), truth, thin)
    assert said[29] == [Health.TRACKING] * 2
    assert said[-1] == [Health.CONVERGING, Health.TRACKING]


def off_its_sheet(psi, r=1.0, **config):
    """One drive, by a data sheet with so many times its flux and resistance."""
    wrong = {"R_s": BENCH_MOTOR.R_s * r, "psi_pm": BENCH_MOTOR.psi_pm * psi}
    return Bank([BENCH_MOTOR.model_copy(update=wrong)], Estimator(**config), 0.02)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize(("r", "psi"), [(1.2, 1.0), (0.8, 1.0), (1.0, 0.95), (1.2, 1.05)])
def test_a_motor_off_its_data_sheet_is_learnt_by_the_voltage_it_lacks(kind, r, psi):
    """Without that the speed stays off by as many per cent as the voltage."""
    w, load = 120.0, 15.0
    truth = steady(w, load, n=1, seconds=3.0)
    filters = off_its_sheet(psi, r, kind=kind)
    for _ in run(filters, truth, sampled(truth, 16, 2e-4, seed=4)):
        pass
    i_q = load / (1.5 * BENCH_MOTOR.pole_pairs * BENCH_MOTOR.psi_pm)
    lacking = (1.0 - r) * BENCH_MOTOR.R_s * i_q + (1.0 - psi) * BENCH_MOTOR.psi_pm * w
    assert filters.filters.v_q_bias[0] == pytest.approx(lacking, abs=0.15)
    assert filters.x[0, 2] == pytest.approx(w, rel=0.005)
    assert filters.filters.r_scale[0] < 3.0


@pytest.mark.parametrize(("r", "psi"), [(1.0, 0.83), (1.0, 1.2), (1.2, 1.0), (0.8, 0.9)])
def test_what_the_motor_lacks_is_known_with_the_lock(r, psi):
    """The chords are too long by it: no transient of the load after the start."""
    w, load = 150.0, 15.0
    truth = steady(w, load, n=1, seconds=0.4)
    filters, off = off_its_sheet(psi, r), []
    for _, (estimate,), _ in run(filters, truth, sampled(truth, 16, 2e-4, seed=4)):
        if estimate.health is Health.TRACKING:
            off.append(abs(estimate.load_nm - load) / load)
    assert len(off) > 20
    assert max(off) < 0.15


@pytest.mark.parametrize("psi", [0.8, 1.25])
def test_a_flux_that_no_resistance_explains_scales_the_load(psi):
    """The sheet's flux is off by a fifth; without this the load reads 20 % low or 25 % high."""
    load = 15.0
    truth = steady(150.0, load, n=1, seconds=2.0)
    filters = off_its_sheet(psi)
    said = [e[0].load_nm for _, e, _ in run(filters, truth, sampled(truth, 16, 2e-4, seed=5))]
    assert said[30] == pytest.approx(load, rel=0.16), "known with the lock"
    assert said[-1] == pytest.approx(load, rel=0.1)
    right = bank(1)
    for _ in run(right, truth, sampled(truth, 16, 2e-4, seed=5)):
        pass
    assert right.told.flux[0] == 1.0, "what is within the doubt changes nothing"
