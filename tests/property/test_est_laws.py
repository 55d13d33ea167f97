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
from tests.reference import ekf, kalman, motor_model, ukf
from tests.strategies import filter_states, motor_rows, sample_rows

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


@UNTIMED
@given(motor_rows(), filter_states())
def test_jacobian_is_the_derivative(row, state):
    par, x = pmsm.motors(row), np.array([state])
    got = motor_model.jacobian(par, x, SUB_STEP_S)[0]
    for j, h in enumerate([1e-3, 1e-3, 1e-2, 1e-5, 1e-3]):
        e = h * np.eye(5)[j]
        up = motor_model.step(par, x + e, np.zeros((1, 2)), SUB_STEP_S)[0]
        down = motor_model.step(par, x - e, np.zeros((1, 2)), SUB_STEP_S)[0]
        assert got[:, j] == pytest.approx((up - down) / (2.0 * h), rel=1e-6, abs=1e-6)


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


@BOTH
@UNTIMED
@given(rows=sample_rows(DRIVES), order=st.permutations(range(DRIVES)))
def test_permuted_drives_give_permuted_results(kind, rows, order):
    par = pmsm.motors(
        (0.28, 3.5e-3, 0.2, 4, 0.04, 0, 1.5),
        (0.05, 1e-3, 0.9, 3, 2, 0.1, 1.5),
        (0.1, 2e-3, 0.5, 2, 1, 0.0, 1.0),
    )
    states = np.array([[1.0, 2.0, 90.0, 0.3, 5.0], [9.0, 0, -200, 3.0, 1], [0, 0, 0, -1.0, 0]])
    x, P, nis, ok = run(kind, par, states.copy(), wide(DRIVES), rows)
    index = np.array(order)
    place = np.argsort(index)
    moved = [(int(place[r[0]]), *r[1:]) for r in rows]
    par_moved = pmsm.Pmsm(*(value[index] for value in par))
    x_moved, P_moved, nis_moved, ok_moved = run(kind, par_moved, states[index], wide(DRIVES), moved)
    np.testing.assert_array_equal(x_moved, x[index])
    np.testing.assert_array_equal(P_moved, P[index])
    np.testing.assert_array_equal(nis_moved, nis)
    np.testing.assert_array_equal(ok_moved, ok[index])


@UNTIMED
@given(filter_states(), st.floats(-3.0, 3.0))
def test_the_frame_has_no_preferred_direction(state, turn):
    """Turn stator frame, currents, voltage and rotor together: the same motor."""
    x = np.array([state])
    u = np.array([[11.0, -7.0]])

    def turned(v):
        z = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * turn)
        return np.stack([z.real, z.imag], axis=1)

    x_turned = x.copy()
    x_turned[:, :2] = turned(x[:, :2])
    x_turned[:, 3] += turn
    plain = motor_model.step(pmsm.BENCH_MOTOR, x, u, SUB_STEP_S)
    other = motor_model.step(pmsm.BENCH_MOTOR, x_turned, turned(u), SUB_STEP_S)
    assert other[:, :2] == pytest.approx(turned(plain[:, :2]), abs=1e-9)
    assert other[:, 2:] == pytest.approx(plain[:, 2:] + [0.0, turn, 0.0], abs=1e-9)


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


def test_arrays_have_the_annotated_shapes(monkeypatch):
    """The shape strings are checked here, at run time, for one pass through everything."""
    import inspect
    import typing

    import jaxtyping
    from beartype import beartype

    names = {name: getattr(jaxtyping, name) for name in ("Float", "Int", "Bool")}

    def checked(function):
        module = inspect.getmodule(function)
        for name, kind in names.items():
            monkeypatch.setattr(module, name, kind, raising=False)
        monkeypatch.setattr(
            function, "__annotations__", typing.get_type_hints(function), raising=False
        )
        return jaxtyping.jaxtyped(function, typechecker=beartype)

    n = 3
    par = pmsm.repeat(pmsm.BENCH_MOTOR, n)
    noise = noise_of(par, n)
    x, P, two = np.zeros((n, 5)), wide(n), np.ones((n, 2))
    assert checked(pmsm.table)(par).shape == (n, 7)
    assert checked(motor_model.step)(par, x, two, SUB_STEP_S).shape == (n, 5)
    assert checked(motor_model.jacobian)(par, x, SUB_STEP_S).shape == (n, 5, 5)
    assert checked(motor_model.coast)(par, x, np.ones(n)).shape == (n, 5)
    assert checked(motor_model.coast_jacobian)(par, x, np.ones(n)).shape == (n, 5, 5)
    assert checked(motor_model.turning)(two, np.ones(n), 4, SUB_STEP_S).shape == (n, 4, 2)
    assert checked(motor_model.torque)(par, x).shape == (n,)
    checked(kalman.predict)(x, P, P, P)
    checked(kalman.update)(x, P, two, ekf.H, np.tile(np.eye(2), (n, 1, 1)))
    checked(ekf.predict)(par, noise, x, P, two, 2, SUB_STEP_S)
    checked(ekf.coast)(par, noise, x, P, 2, SUB_STEP_S)
    checked(ekf.update)(noise, x, P, two)
    checked(ekf.healthy)(x, P)
    checked(ukf.predict)(par, noise, x, P, two, 2, SUB_STEP_S)
    checked(ukf.factor)(P)
    rows = (np.arange(n, dtype=np.int32), two, two, np.ones(n, np.int64), np.zeros(n, np.int64))
    checked(ekf.sweep)(par, noise, x, P, *rows, SUB_STEP_S)
    checked(ukf.sweep)(par, noise, x, P, *rows, SUB_STEP_S)
    with pytest.raises(Exception, match=r"shape|type"):
        checked(motor_model.step)(par, np.zeros((n, 4)), two, SUB_STEP_S)
