"""What the tuned filter is worth: load error on scenarios that nobody tuned on.

Tuned on seeds 5, 101 and 102; these are others. Bounds are the measured values plus a tenth.
"""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from estimators import filters
from estimators.models import pmsm
from tests.core_calls import acquisition
from tests.core_calls.filters import sweep
from tests.filter_records import acquire, start_states
from tests.unit.test_est_acquisition import rated
from tests.unit.test_est_ekf import bench
from tests.unit.test_est_truth import TICK_S, motor, sampled

DRIVES = 12
SEEDS = (201, 202, 203)


def scenario(w, seed, ticks=12_000):
    """Constant speed, loads 5-25 Nm with two steps and one loss of 20-100 %, edges of 4 ms."""
    rng = np.random.default_rng(seed)
    t = np.arange(ticks)
    load = np.empty((ticks, DRIVES))
    for n in range(DRIVES):
        curve = np.full(ticks, rng.uniform(5.0, 25.0))
        for _ in range(2):
            step = rng.uniform(5.0, 25.0) - curve[-1]
            curve = curve + step * ndtr((t - rng.uniform(0.2, 0.9) * ticks) / 30.0)
        begin = rng.uniform(0.25, 0.7) * ticks
        end = begin + rng.uniform(0.1, 0.4) / TICK_S
        loss = ndtr((t - begin) / 30.0) - ndtr((t - end) / 30.0)
        load[:, n] = curve * (1.0 - rng.uniform(0.2, 1.0) * loss)
    theta = rng.uniform(-math.pi, math.pi, DRIVES)
    ref = np.full((ticks, DRIVES), w)
    return motor(np.full(DRIVES, w), theta, ref, load * math.copysign(1.0, w))


def load_rmse(w, every, kind="ekf", **changes):
    """Nm over all drives and seeds from 0.25 s, filters started by acquisition at 0.1 s."""
    errors, _ = load_errors(w, every, kind, **changes)
    return math.sqrt(np.mean(np.square(errors)))


def load_errors(w, every, kind="ekf", **wrong):
    """Errors and loads, Nm, (T, N)."""
    par, _ = bench(DRIVES)
    par = par._replace(**{name: getattr(par, name) * factor for name, factor in wrong.items()})
    i_lsb = 0.02 if every >= 16 else 0.05
    noise = pmsm.default_noise(par, rated(DRIVES), i_lsb=i_lsb)
    table = pmsm.table(par)
    errors, loads = [], []
    for seed in SEEDS:
        truth = scenario(w, seed)
        rows = sampled(truth, every, 2e-4, seed + 1)
        state, x, P = acquisition.start(DRIVES), np.zeros((DRIVES, 5)), np.zeros((DRIVES, 5, 5))
        first = rows.tick < 800
        acquire(state, par, [column[first] for column in rows[:5]], TICK_S)
        assert state.ready.all()
        x, P = start_states(state, par, noise, rated(DRIVES))
        for end in range(816, len(truth.w) + 1, 16):
            now = slice(*np.searchsorted(rows.tick, [end - 16, end]))
            samples = filters.sample_records(*(column[now] for column in rows[:5]))
            _, ok = sweep(kind, table, noise, x, P, samples, TICK_S)
            assert ok.all()
            if end > 2000:
                errors.append(x[:, 4] - truth.load[end - 1])
                loads.append(truth.load[end - 1])
    return np.array(errors), np.array(loads)


BOUNDS = {
    16: {50.0: 0.75, 100.0: 0.75, -200.0: 0.75, 300.0: 0.77, 600.0: 0.80, -1000.0: 0.90},
    1: {
        50.0: 0.75, 100.0: 0.75, -200.0: 0.75, 300.0: 0.75, 1000.0: 0.75, -3000.0: 0.95,
        5000.0: 1.75,
    },
}  # fmt: skip
"""Nm, by sub-steps per sample and electrical speed."""


@pytest.mark.parametrize(("every", "w", "bound", "kind"), [
    pytest.param(every, w, bound, kind, marks=[pytest.mark.thorough] * ((k + 2 * j) % 4 > 0))
    for every, bounds in BOUNDS.items()
    for k, (w, bound) in enumerate(bounds.items())
    for j, kind in enumerate(("ekf", "ukf"))
])  # fmt: skip
def test_load_error(every, w, bound, kind):
    assert load_rmse(w, every, kind) < bound


@pytest.mark.parametrize("w", [100.0, 400.0, -800.0, 1150.0])
def test_the_load_does_not_read_low_with_speed(w):
    """A voltage held between samples read 5 % low at 400 rad/s, 19 % at 800."""
    errors, loads = load_errors(w, 16)
    assert np.mean(errors) / np.mean(loads) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("wrong", "bound"),
    [
        ({"R_s": 1.2}, 1.2),
        ({"R_s": 0.8}, 1.2),
        ({"psi_f": 1.03, "R_s": 1.2, "L_s": 0.95}, 1.2),
        ({"psi_f": 0.8}, 8.0),
        ({"psi_f": 1.2}, 6.0),
    ],
)
def test_wrong_constants_cost_little(wrong, bound):
    assert load_rmse(200.0, 16, **wrong) < bound
