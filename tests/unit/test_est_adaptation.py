"""What is learnt while a filter runs: the noise of its sensors, the voltage its motor lacks."""

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import pointer
from estimators import filters
from estimators.models import pmsm
from tests.core_calls import acquisition, adaptation
from tests.filter_records import samples
from tests.reference import adaptation as reference

adapt_r, adapt_q_bias = lib.adapt_r, lib.adapt_q_bias
R_SCALE_MAX = 400.0
SETTLED = lib.FILTER_SETTLE_STEPS


def q_bias_limit(w, R_s, psi_f, I_rated):
    motor = pmsm.table(pmsm.BENCH_MOTOR)
    motor[0, [0, 2]] = R_s, psi_f
    return lib.q_bias_limit(w, pointer("struct pmsm", motor), I_rated)


def settle(true_scale, seconds=5.0, dt=2e-3, seed=0, now=1.0):
    """Innovations of a filter whose R is `now` times the configured and nothing else is noisy."""
    rng = np.random.default_rng(seed)
    at = []
    for k in range(round(seconds / dt)):
        nis = float(np.sum(rng.normal(size=2) ** 2)) * true_scale / now
        now = adapt_r(now, nis, dt, k * dt)
        at.append(now)
    return at


@pytest.mark.parametrize("true_scale", [1.0, 5.0, 50.0])
def test_it_finds_the_scale_within_half_a_second_and_stays(true_scale):
    at = settle(true_scale)
    assert np.median(at[250:]) == pytest.approx(true_scale, rel=0.35)
    assert min(at) >= 1.0


def test_it_is_bounded_whatever_comes():
    assert settle(1e9)[-1] <= R_SCALE_MAX
    assert adapt_r(1.0, 0.0, 2e-3, 1.0) == 1.0
    assert adapt_r(R_SCALE_MAX, 1e300, 10.0, 0.0) == R_SCALE_MAX


def test_a_burst_is_not_noise():
    at = settle(1.0, seconds=2.0)
    now = at[-1]
    for _ in range(15):
        now = adapt_r(now, 1e3, 2e-3, 2.0)
    assert now < 1.35 * at[-1], "30 ms of an edge cost no more than this"


def drawn(rng, n, extreme):
    """Filters, chords and motors of n drives, in any state; extreme: those of a damaged record."""
    motor = pmsm.table(pmsm.repeat(pmsm.BENCH_MOTOR, n))
    motor[:, [0, 2]] *= rng.uniform(0.1, 10.0, (n, 2))
    chords, drives = acquisition.start(n), filters.unstarted(n)
    chords.w, chords.ready = rng.normal(0, 300, n), rng.random(n) < 0.8
    drives.active, drives.steps = rng.random(n) < 0.8, rng.integers(0, 2 * SETTLED, n)
    drives.x[:, 2] = chords.w + rng.normal(0, 30, n)
    drives.r_scale, drives.v_q_bias = rng.uniform(1.0, R_SCALE_MAX, n), rng.normal(0, 1, n)
    if extreme:
        chords.w, drives.x[:, 2] = rng.choice(EXTREMES, (2, n))
        drives.steps = rng.choice([0, SETTLED - 1, SETTLED, 1 << 40], n)
        drives.r_scale = rng.choice([1.0, R_SCALE_MAX], n)
    return motor, chords, drives


EXTREMES = np.array([0.0, -0.0, 1e-300, -1e300, 1e300, np.inf, -np.inf, np.nan])


@pytest.mark.parametrize("extreme", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_innovations_change_their_own_filter_as_the_laws_say(seed, extreme):
    """One by one, against `tests/reference/adaptation.py`."""
    rng = np.random.default_rng(seed)
    n, dt = 16, 125e-6
    motor, chords, drives = drawn(rng, n, extreme)
    rated, expected = rng.uniform(5.0, 500.0, n), drives.copy()
    for _ in range(50):
        drive = rng.integers(0, n, 12)
        nis = np.where(rng.random(12) < 0.1, np.nan, rng.exponential(5.0, 12))
        if extreme:
            nis = rng.choice(EXTREMES, 12)
        none = np.zeros((12, 2))
        rows = samples(drive, none, none, rng.integers(1, 17, 12), 0, nis)
        adaptation.adapt(rows, drives, chords, motor, rated, dt)
        with np.errstate(over="ignore"):
            reference.adapt(rows, expected, chords, motor, rated, dt)
        assert drives.steps.tolist() == expected.steps.tolist()
        for name in ("nis", "r_scale", "v_q_bias"):
            np.testing.assert_allclose(drives[name], expected[name], 1e-11, 1e-13, err_msg=name)
    if not extreme:
        assert (drives.r_scale != 1.0).any()
        assert (drives.v_q_bias != 0.0).any()


def test_the_first_missing_voltage_is_what_the_chords_are_too_long_by():
    motor = pmsm.table(pmsm.BENCH_MOTOR)
    chords = acquisition.start(1)
    chords.w, chords.psi = -100.0, motor[0, 2] + 0.01
    assert adaptation.first_q_bias(chords, 0, motor, 25.0) == pytest.approx(-1.0)
    limit = q_bias_limit(-100.0, motor[0, 0], motor[0, 2], 25.0)
    chords.psi = 1.0
    assert adaptation.first_q_bias(chords, 0, motor, 25.0) == -limit
    chords.psi = np.nan
    assert adaptation.first_q_bias(chords, 0, motor, 25.0) == 0.0, "not known"


def test_a_missing_voltage_is_bounded_by_what_a_data_sheet_can_be_off():
    most = q_bias_limit(100.0, 0.28, 0.2, 25.0)
    assert most == pytest.approx(0.3 * 0.28 * 25.0 + 0.2 * 0.2 * 100.0)
    at = 0.0
    for _ in range(10000):
        at = adapt_q_bias(at, 500.0, 0.2, 2e-3, most, 1.0)
    assert at == most
    for _ in range(20000):
        at = adapt_q_bias(at, -500.0, 0.2, 2e-3, most, 1.0)
    assert at == -most


def test_a_new_filter_learns_the_missing_voltage_faster():
    """Nearly half of it in the first 0.1 s; later it takes half a second."""
    missing, psi = 2.0, 0.2

    def after(seconds, age):
        at = 0.0
        for k in range(round(seconds / 2e-3)):
            at = adapt_q_bias(at, (missing - at) / psi, psi, 2e-3, 10.0, age + k * 2e-3)
        return at

    assert after(0.1, 0.06) > 0.45 * missing
    assert after(0.1, 10.0) < 0.25 * missing
