"""Laws of the estimators that hold for every motor, state and input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import filters
from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S, Rated
from tests.core_calls import acquisition
from tests.core_calls.filters import sweep
from tests.filter_records import acquire, estimate, start_states
from tests.reference import ekf
from tests.strategies import filter_states, sample_rows

DRIVES = 3
# Kernels compile in the first example: no deadline is meaningful.
UNTIMED = settings(deadline=None)
BOTH = pytest.mark.parametrize("kind", ["ekf", "ukf"])


def rated(n):
    return Rated(np.full(n, 25.0), np.full(n, 30.0))


def noise_of(par, n):
    return pmsm.default_noise(par, rated(n))


def run(kind, par, x, P, rows):
    """Sweep rows as `sample_rows` gives them; (x, P, nis, ok)."""
    noise = noise_of(par, len(x))
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    drive = table[:, 0].astype(np.int32)
    n_sub, n_gap = np.full(len(table), 16, dtype=np.int64), table[:, 5].astype(np.int64)
    samples = filters.sample_records(drive, table[:, 1:3], table[:, 3:5], n_sub, n_gap)
    nis, ok = sweep(kind, pmsm.table(par), noise, x, P, samples, SUB_STEP_S)
    return x, P, nis, ok


def wide(n):
    return np.tile(np.diag([1.0, 1.0, 100.0, 0.1, 900.0]), (n, 1, 1))


@BOTH
@UNTIMED
@given(rows=sample_rows(DRIVES), states=st.lists(filter_states(), min_size=3, max_size=3))
def test_covariances_stay_positive_and_nothing_raises(kind, rows, states):
    """Whatever arrives: x and P finite, P symmetric and positive, nis >= 0 or NaN."""
    par = pmsm.repeat(pmsm.BENCH_MOTOR, DRIVES)
    x, P, nis, ok = run(kind, par, np.array(states), wide(DRIVES), rows)
    assert np.isfinite(x).all()
    assert np.isfinite(P).all()
    assert (np.swapaxes(P, 1, 2) == P).all()
    scale = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    correlation = P / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    assert (np.abs(x[:, 3]) <= np.pi + 1e-12).all()
    assert (nis[np.isfinite(nis)] >= 0.0).all()
    stopped = {int(r[0]) for r in rows} - set(np.flatnonzero(ok).tolist())
    assert stopped == {int(r[0]) for r, v in zip(rows, nis, strict=True) if np.isnan(v)}


@UNTIMED
@given(sample_rows(DRIVES))
def test_acquisition_takes_anything(rows):
    """Never raises, estimates stay finite, and nonsense is never `ready`."""
    par = pmsm.repeat(pmsm.BENCH_MOTOR, DRIVES)
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    state = acquisition.start(DRIVES)
    rows = (table[:, 0], table[:, 1:3], table[:, 3:5], np.full(len(table), 16), table[:, 5])
    acquire(state, par, rows, SUB_STEP_S)
    ready, w, theta, _ = estimate(state)
    assert np.isfinite(w).all()
    assert np.isfinite(theta).all()
    assert not ready.any()
    x, P = start_states(state, par, noise_of(par, DRIVES), rated(DRIVES))
    assert ekf.healthy(x, P).all()
