"""The load observer: an ordinary Kalman filter, and right about constant and stepping loads."""

import numpy as np
import pytest
from _traction_core import ffi, lib
from filterpy.kalman import KalmanFilter

from tests.reference import load_observer as reference
from tests.reference.load_observer import LoadState, Mechanics

BENCH = Mechanics(J=0.04, B=0.002, speed_var=3e-4, load_rate=800.0)
DT = 0.01


def values(state):
    """All fields of a `struct load_observer`."""
    return LoadState(*(getattr(state, name) for name in LoadState._fields))


def first(w, torque, mechanics):
    """`load_observer_init`."""
    state = ffi.new("struct load_observer *")
    lib.load_observer_init(state, w, torque, ffi.new("struct mechanics *", mechanics))
    return values(state)


def observe(state, w, torque, dt, mechanics):
    """`load_observer_update`."""
    made = ffi.new("struct load_observer *", state)
    lib.load_observer_update(made, w, torque, dt, ffi.new("struct mechanics *", mechanics))
    return values(made)


def run(load, seconds=2.0, noise=0.0, mechanics=BENCH, seed=0):
    """Integrate a rotor under 20 Nm and `load(t)`; gives the observer's states."""
    rng = np.random.default_rng(seed)
    w, fine, states = 30.0, 100, []
    state = first(w, 20.0, mechanics)
    for k in range(round(seconds / DT)):
        for i in range(fine):
            t = k * DT + i * DT / fine
            w += DT / fine / mechanics.J * (20.0 - mechanics.B * w - load(t))
        state = observe(state, w + rng.normal(0.0, noise), 20.0, DT, mechanics)
        states.append(state)
    return states


def test_a_new_start_knows_nothing_of_the_one_before():
    state = ffi.new("struct load_observer *", observe(first(1.0, 2.0, BENCH), 5.0, 3.0, DT, BENCH))
    lib.load_observer_init(state, 30.0, 20.0, ffi.new("struct mechanics *", BENCH))
    assert values(state) == first(30.0, 20.0, BENCH)


def test_constant_load_is_found_without_bias():
    states = run(lambda _t: 14.0)
    assert np.abs(states[-1].T_L - 14.0) < 5e-3


def test_a_step_is_followed_within_three_readings():
    states = run(lambda t: 20.0 if t < 1.0 else 6.0)
    at = [s.T_L for s in states]
    assert at[98] == pytest.approx(20.0, abs=0.1)
    assert at[102] == pytest.approx(6.0, abs=1.0)


def sigma_of(state):
    """`load_observer_sigma`."""
    return lib.load_observer_sigma(ffi.new("struct load_observer *", state))


def test_its_own_sigma_is_honest():
    states = run(lambda _t: 18.0, seconds=20.0, noise=BENCH.speed_var**0.5)[50:]
    errors = np.array([s.T_L - 18.0 for s in states])
    assert np.sqrt(np.mean(errors**2)) < np.sqrt(states[-1].P_LL)
    inside = np.abs(errors) <= 2.0 * np.array([sigma_of(s) for s in states])
    assert np.mean(inside) > 0.93
    assert np.mean([s.nis for s in states]) < 1.5


def test_a_quieter_sensor_narrows_the_band_and_a_load_that_swings_widens_it():
    quiet = run(lambda _t: 18.0, seconds=10.0, noise=0.1 * BENCH.speed_var**0.5)[-1]
    swinging = run(lambda t: 18.0 + 15.0 * np.sin(40.0 * t), seconds=10.0)
    assert sigma_of(quiet) < 0.5 * np.sqrt(quiet.P_LL)
    assert sigma_of(swinging[-1]) > np.sqrt(swinging[-1].P_LL)


def test_it_equals_filterpy():
    m = BENCH
    kf = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    q = m.load_rate * DT
    kf.F = np.array([[1.0 - m.B * DT / m.J, -DT / m.J], [0.0, 1.0]])
    kf.B = np.array([[DT / m.J], [0.0]])
    kf.H = np.array([[1.0, 0.0]])
    kf.R *= m.speed_var
    b = -DT / m.J
    kf.Q = np.array([[b * b * q / 3.0, 0.5 * b * q], [0.5 * b * q, q]])
    state = first(30.0, 20.0, m)
    kf.x = np.array([[state.w], [state.T_L]])
    kf.P = np.diag([state.P_ww, state.P_LL])
    rng = np.random.default_rng(3)
    last = 20.0
    for _ in range(200):
        w, torque = 30.0 + rng.normal(), 20.0 + rng.normal()
        kf.predict(u=np.array([[0.5 * (last + torque)]]))
        kf.update(np.array([[w]]))
        state = observe(state, w, torque, DT, m)
        last = torque
        assert [state.w, state.T_L] == pytest.approx(kf.x.ravel().tolist(), abs=1e-9)
        assert [[state.P_ww, state.P_wL], [state.P_wL, state.P_LL]] == pytest.approx(kf.P, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_it_equals_the_reference(seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        m = Mechanics(*10.0 ** rng.uniform(-4, 4, 4))
        mine, plain = first(5.0, 20.0, m), reference.first(5.0, 20.0, m)
        for k in range(20):
            assert mine == pytest.approx(plain, rel=1e-12, abs=1e-300)
            given = rng.normal(0.0, 30.0), rng.normal(0.0, 30.0), DT * (1 + k % 5), m
            mine, plain = observe(plain, *given), reference.observe(plain, *given)
            assert mine == plain
            assert sigma_of(mine) == pytest.approx(plain.sigma, rel=1e-12)
