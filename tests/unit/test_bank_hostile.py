"""The bank under samples that no motor makes: finite, positive, and well again when they end.

R29, R30 of docs/reliability.md. Steps are sub-steps of one drive's filter, 125 us each.
"""

import math

import numpy as np
import pytest

from gateway.core.codes import Health
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Estimator
from tests.estimates import step
from tests.sample_rows import Samples
from tests.stations import Bank
from tests.unit.test_bank import TICK, steady
from tests.unit.test_est_truth import Rows, sampled

TURNS_A_SECOND = 16
W = 2.0 * math.pi * TURNS_A_SECOND
"""Whole turns a second, so that a second of samples can be repeated."""
SECOND_TICKS = 100
AGAIN_TICKS = 100
"""Honest samples end everything within a second."""


def mixed(rng, shape):
    """Any 64 bits, read as a number."""
    return rng.integers(0, 1 << 64, shape, dtype=np.uint64, endpoint=False).view(np.float64)


MADE = {
    "nan": lambda rng, x: np.full_like(x, np.nan),
    "infinite": lambda rng, x: np.copysign(np.inf, x),
    "huge": lambda rng, x: np.copysign(1e308, x),
    "tiny": lambda rng, x: np.full_like(x, 5e-324),
    "saturated": lambda rng, x: np.copysign(655.0, x),
    "nothing": lambda rng, x: np.zeros_like(x),
    "any bits": lambda rng, x: mixed(rng, x.shape),
    "swapped": lambda rng, x: x[:, ::-1].copy(),
    "one in a hundred": lambda rng, x: np.where(rng.random(x.shape) < 0.01, np.nan, x),
}


def loop(n, every, speed=W):
    """A second of n steady drives that can follow itself."""
    truth = steady(speed, 15.0 if speed else 0.0, n, seconds=2.0)
    rows = sampled(truth, every, 2e-4, seed=2)
    late = rows.tick >= SECOND_TICKS * TICK
    return Rows(*(column[late] for column in rows))._replace(tick=rows.tick[late] % (100 * TICK))


def ticks_of(rows):
    """The samples of each tick of the second."""
    order = np.argsort(rows.tick, kind="stable")
    cuts = np.searchsorted(rows.tick[order], np.arange(1, SECOND_TICKS) * TICK)
    columns = [np.split(column[order], cuts) for column in rows[:5]]
    return [Samples(*parts) for parts in zip(*columns, strict=True)]


def sound(bank):
    """States finite, covariances symmetric and positive, whatever came."""
    assert np.isfinite(bank.x).all()
    assert np.isfinite(bank.P).all()
    assert np.allclose(bank.P, bank.P.transpose(0, 2, 1), rtol=1e-9, atol=1e-12)
    # What is no number here would be kept for good.
    for name in bank.sensors.dtype.names:
        column = np.array(bank.sensors[name].tolist(), dtype=complex)
        assert not np.isnan(column).any()
    for total in (bank.chords.S0, bank.chords.S1, bank.chords.S2):
        assert (np.abs(total) < 1e12).all()
    values = np.linalg.eigvalsh(bank.P)
    assert (values[:, 0] >= -1e-12 * values[:, -1]).all()


def told(bank, samples, tick, n):
    estimates = step(bank, samples, [True] * n, (tick + 1) * 10_000_000)
    for estimate in estimates:
        for number in estimate[1:5]:
            assert number is None or math.isfinite(number)
    return estimates


@pytest.mark.parametrize(
    "steps", [1_000_000, pytest.param(10_000_000, marks=[pytest.mark.slow, pytest.mark.thorough])]
)
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_numbers_that_are_none_get_neither_in_nor_out(kind, steps):
    n = 32
    bank = Bank([BENCH_MOTOR] * n, Estimator(kind=kind), 0.05)
    seconds = ticks_of(loop(n, every=1))
    rng = np.random.default_rng(5)
    names = list(MADE)
    until = np.zeros(n, dtype=int)
    mode = np.full(n, -1)
    diverged = 0
    for tick in range(steps // (n * TICK)):
        drive, u, y, n_sub, n_gap = seconds[tick % SECOND_TICKS]
        for d in np.flatnonzero(until <= tick):
            until[d] = tick + rng.integers(1, 60)
            mode[d] = rng.integers(len(names)) if rng.random() < 0.6 else -1
        u, y, gap = u.copy(), y.copy(), n_gap.copy()
        for d in np.flatnonzero(mode >= 0):
            mine = drive == d
            make = MADE[names[mode[d]]]
            if rng.random() < 0.8:
                y[mine] = make(rng, y[mine])
            if rng.random() < 0.3:
                u[mine] = make(rng, u[mine])
            if rng.random() < 0.05:
                gap[np.flatnonzero(mine)[0]] = rng.integers(0, 1600)
        with np.errstate(all="ignore"):
            estimates = told(bank, Samples(drive, u, y, n_sub, gap), tick, n)
        diverged += sum(e.health is Health.DIVERGED for e in estimates)
        sound(bank)
    assert diverged > 100, "it was hostile"
    tick = steps // (n * TICK) // SECOND_TICKS * SECOND_TICKS + SECOND_TICKS
    for k in range(tick, tick + AGAIN_TICKS):
        estimates = told(bank, seconds[k % SECOND_TICKS], k, n)
    sound(bank)
    assert [e.health for e in estimates] == [Health.TRACKING] * n
    assert [e.speed_rad_s for e in estimates] == pytest.approx([W / 4.0] * n, abs=0.5)
    assert [e.load_nm for e in estimates] == pytest.approx([15.0] * n, abs=1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seconds"), [
    ("ekf", 300), ("ukf", 60),
    *(pytest.param(kind, 3600, marks=pytest.mark.thorough) for kind in ("ekf", "ukf")),
])  # fmt: skip
def test_long_standstill_leaves_no_trace(kind, seconds):
    n = 2
    bank = Bank([BENCH_MOTOR] * n, Estimator(kind=kind), 0.02)
    still, moving = (ticks_of(loop(n, every=16, speed=w)) for w in (0.0, W))
    for tick in range(seconds * SECOND_TICKS):
        said = step(bank, still[tick % SECOND_TICKS], [True] * n, (tick + 1) * 10_000_000)
        if tick % 100 == 0:
            assert all(e.health is not Health.TRACKING for e in said)
            sound(bank)
    tick += 1
    for k in range(tick, tick + AGAIN_TICKS):
        estimates = told(bank, moving[k % SECOND_TICKS], k, n)
    assert [e.health for e in estimates] == [Health.TRACKING] * n
    assert [e.load_nm for e in estimates] == pytest.approx([15.0] * n, abs=1.0)
