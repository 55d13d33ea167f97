"""Do the filters know how wrong they are? NEES and windows of NIS in the filters' own world.

Fifty motors move by the filters' model with process noise Q and are measured with noise R: what
is left of chi-square is the filters' own fault. Bands after Bar-Shalom, Li, Kirubarajan 2001, 5.4.
"""

import math

import numpy as np
import pytest
from _traction_core import lib
from scipy.stats import chi2

from estimators import filters
from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S, THETA_E, W_E
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from tests.core_calls.filters import sweep
from tests.reference import motor_model
from tests.stations import last_samples
from tests.storm.train import LOOP_TICKS, NODES, PHASES, TICK, train
from tests.unit.test_est_ekf import bench

RUNS = 50
WINDOW = 100
FIRST_P = np.array([0.01, 0.01, 4.0, 1e-3, 4.0])


def control(par, x, w_ref):
    """Voltage (N, 2) that holds the speed, from the true state: the filter is told it exactly."""
    turn = np.exp(1j * x[:, THETA_E])
    i = (x[:, 0] + 1j * x[:, 1]) / turn
    i_q = np.clip(x[:, 4] / (par.k_p * par.p * par.psi_f) + 0.5 * (w_ref - x[:, W_E]), -60, 60)
    u = par.R_s * i + 1j * x[:, W_E] * (par.L_s * i + par.psi_f)
    u = u + 0.05 * par.L_s / SUB_STEP_S * (1j * i_q - i)
    u = u * turn
    return np.stack([u.real, u.imag], axis=1)


def track(kind, w, every, samples, seed, worse=1.0):
    """NEES (samples, RUNS) and NIS (samples, RUNS) of filters in a world of their own model.

    worse: variance of the sensors over the one that the filter is told.
    """
    rng = np.random.default_rng(seed)
    par, noise = bench(RUNS)
    table = pmsm.table(par)
    truth = np.zeros((RUNS, 5))
    truth[:, W_E], truth[:, 4] = w, 10.0
    truth[:, THETA_E] = rng.uniform(-math.pi, math.pi, RUNS)
    x = truth + rng.normal(size=(RUNS, 5)) * np.sqrt(FIRST_P)
    P = np.tile(np.diag(FIRST_P), (RUNS, 1, 1))
    drive = np.arange(RUNS, dtype=np.int32)
    n_sub, n_gap = np.full(RUNS, every, dtype=np.int64), np.zeros(RUNS, dtype=np.int64)
    nees, nis = np.empty((samples, RUNS)), np.empty((samples, RUNS))
    for k in range(samples):
        u = control(par, truth, w)
        v = motor_model.turning(u, truth[:, W_E], every, SUB_STEP_S)
        for j in range(every):
            truth = motor_model.step(par, truth, v[:, j], SUB_STEP_S)
            truth = truth + rng.normal(size=truth.shape) * np.sqrt(noise.Q)
        y = truth[:, :2] + rng.normal(size=(RUNS, 2)) * np.sqrt(worse * noise.R)
        samples = filters.sample_records(drive, u, y, n_sub, n_gap)
        nis[k], ok = sweep(kind, table, noise, x, P, samples, SUB_STEP_S)
        assert ok.all()
        error = truth - x
        error[:, THETA_E] = motor_model.wrap(error[:, THETA_E])
        nees[k] = np.einsum("ni,ni->n", error, np.linalg.solve(P, error[..., None])[..., 0])
    return nees, nis


CASES = [("ekf", 1), ("ekf", 16), ("ukf", 1), ("ukf", 16)]


@pytest.mark.parametrize(("kind", "every", "w"), [
    pytest.param(*case, w, marks=[pytest.mark.thorough] * ((j + k) % 3 > 0))
    for j, case in enumerate(CASES) for k, w in enumerate((50.0, 200.0, -300.0))
])  # fmt: skip
def test_nees_and_windows_of_nis_are_chi_square(kind, every, w):
    """ANEES in its 95 % band for at least 90 % of the time, NIS in its 99.9 % band for 99 %."""
    nees, nis = track(kind, w, every, 1000, seed=round(abs(w)) + every)
    low, high = chi2.ppf([0.025, 0.975], 5 * RUNS) / RUNS
    anees = nees.mean(axis=1)
    assert np.mean((anees > low) & (anees < high)) >= 0.90
    low, high = chi2.ppf([0.0005, 0.9995], 2 * WINDOW) / WINDOW
    windows = nis.reshape(-1, WINDOW, RUNS).mean(axis=1)
    assert np.mean((windows > low) & (windows < high)) >= 0.99


@pytest.mark.parametrize(("kind", "every"), CASES)
def test_a_filter_that_believes_too_much_is_found(kind, every):
    """The same bands with sensors of four times the variance that the filter is told."""
    nees, nis = track(kind, 200.0, every, 300, seed=7, worse=4.0)
    _, high = chi2.ppf([0.025, 0.975], 5 * RUNS) / RUNS
    assert np.mean(nees.mean(axis=1) > high) > 0.5
    assert nis.mean() > 2.5


def nominal_windows(kind):
    """Mean NIS of 100 samples in a row, drives tracked, moving, and 300 ms off any loss."""
    config, honest = parse({"estimator": {"kind": kind}}), train()
    core = Gateway(config, honest.codec, 0)
    runs = [[] for _ in NODES]
    windows = []
    for tick in range(1, LOOP_TICKS + 1):
        tracked = [core.bank.filters.steps[d] >= lib.FILTER_SETTLE_STEPS for d in range(len(NODES))]
        core.step(honest.sent(tick), tick * TICK)
        drive = last_samples(core.inbox).drive
        nis = core.bank.samples.nis[: len(drive)]
        losses = honest.lost[max(tick - 31, 0) : tick + 30].any()
        standing = honest.phase[tick - 1] == PHASES.index("standstill")
        for d, run in enumerate(runs):
            if losses or standing or not tracked[d]:
                run.clear()
                continue
            run.extend(nis[drive == d].tolist())
            while len(run) >= WINDOW:
                windows.append(np.mean(run[:WINDOW]))
                del run[:WINDOW]
    return np.array(windows)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_on_a_train_the_filters_never_claim_to_know_more_than_they_do(kind):
    """Q lets the load move as fast as a wheel that slips; most of the time it does not. So the
    windows lie below the band (median 0.42 of 2): the filters are modest, which costs nothing
    but the width of the band that they state."""
    windows = nominal_windows(kind)
    assert len(windows) > 500
    assert windows.max() < chi2.ppf(0.9995, 2 * WINDOW) / WINDOW
