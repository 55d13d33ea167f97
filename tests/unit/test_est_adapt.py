"""What is learnt while a filter runs: the noise of its sensors, the voltage its motor lacks."""

import numpy as np
import pytest

from estimators import lock
from estimators._adapt_kernels import absorb
from estimators.adapt import MOST, MOST_FLUX, MOST_RESISTANCE, lean, most_lean, scale
from estimators.models import pmsm


def settle(true_scale, seconds=5.0, dt=2e-3, seed=0, now=1.0):
    """Innovations of a filter whose R is `now` times the configured and nothing else is noisy."""
    rng = np.random.default_rng(seed)
    at = []
    for k in range(round(seconds / dt)):
        nis = float(np.sum(rng.normal(size=2) ** 2)) * true_scale / now
        now = scale(now, nis, dt, k * dt)
        at.append(now)
    return at


@pytest.mark.parametrize("true_scale", [1.0, 5.0, 50.0])
def test_it_finds_the_scale_within_half_a_second_and_stays(true_scale):
    at = settle(true_scale)
    assert np.median(at[250:]) == pytest.approx(true_scale, rel=0.35)
    assert min(at) >= 1.0


def test_it_is_bounded_whatever_comes():
    assert settle(1e9)[-1] <= MOST
    assert scale(1.0, 0.0, 2e-3, 1.0) == 1.0
    assert scale(MOST, 1e300, 10.0, 0.0) == MOST


def test_a_burst_is_not_noise():
    at = settle(1.0, seconds=2.0)
    now = at[-1]
    for _ in range(15):
        now = scale(now, 1e3, 2e-3, 2.0)
    assert now < 1.35 * at[-1], "30 ms of an edge cost no more than this"


def test_innovations_are_absorbed_one_by_one():
    """The compiled loop against `scale` and `lean` called by hand."""
    rng = np.random.default_rng(3)
    n, dt, smoothing, settled = 3, 125e-6, 0.2, 200
    motor = pmsm.table(pmsm.repeat(pmsm.BENCH_MOTOR, n))
    chords = lock.start(n)
    chords.w[:], chords.ready[:] = 100.0, [True, True, False]
    active, rated, w_e = np.array([True, False, True]), np.full(n, 25.0), np.full(n, 104.0)
    steps, mean = np.zeros(n, dtype=np.int64), np.full(n, 2.0)
    found, lacking = np.ones(n), np.zeros(n)
    plain = [[0, 2.0, 1.0, 0.0] for _ in range(n)]
    most = most_lean(104.0, motor[0, 0], motor[0, 2], 25.0)
    for _ in range(50):
        drive = rng.integers(0, n, 12).astype(np.int32)
        nis = np.where(rng.random(12) < 0.1, np.nan, 20.0 * rng.random(12))
        n_sub = rng.integers(1, 17, 12)
        absorb(
            drive, nis, n_sub, dt, smoothing, settled, motor, rated, w_e, chords, active, steps,
            mean, found, lacking,
        )  # fmt: skip
        for d, value, step in zip(drive.tolist(), nis.tolist(), n_sub.tolist(), strict=True):
            row = plain[d]
            if active[d]:
                row[0] += step
                if value == value:
                    row[1] += smoothing * (value - row[1])
                    row[2] = scale(row[2], value, step * dt, row[0] * dt)
                if row[0] >= settled and chords.ready[d]:
                    row[3] = lean(row[3], 4.0, motor[d, 2], step * dt, most, row[0] * dt)
    assert steps.tolist() == [row[0] for row in plain]
    for column, values in ((1, mean), (2, found), (3, lacking)):
        np.testing.assert_allclose(values, [row[column] for row in plain], rtol=1e-12)
    assert found[0] > 1.0
    assert found[1] == 1.0
    assert lacking[0] > 0.0
    assert lacking[1] == lacking[2] == 0.0


def test_a_missing_voltage_is_bounded_by_what_a_data_sheet_can_be_off():
    most = most_lean(100.0, 0.28, 0.2, 25.0)
    assert most == pytest.approx(MOST_RESISTANCE * 0.28 * 25.0 + MOST_FLUX * 0.2 * 100.0)
    at = 0.0
    for _ in range(10000):
        at = lean(at, 500.0, 0.2, 2e-3, most, 1.0)
    assert at == most
    for _ in range(20000):
        at = lean(at, -500.0, 0.2, 2e-3, most, 1.0)
    assert at == -most


def test_a_new_filter_learns_the_missing_voltage_faster():
    """Nearly half of it in the first 0.1 s; later it takes LEAN_TAU_S."""
    missing, psi = 2.0, 0.2

    def after(seconds, age):
        at = 0.0
        for k in range(round(seconds / 2e-3)):
            at = lean(at, (missing - at) / psi, psi, 2e-3, 10.0, age + k * 2e-3)
        return at

    assert after(0.1, 0.06) > 0.45 * missing
    assert after(0.1, 10.0) < 0.25 * missing
