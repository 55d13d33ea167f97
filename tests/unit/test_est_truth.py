"""A motor to test estimators with: independent of `estimators`, of `sim` and of the chord law.

Rotor-frame equations (the estimators use the stationary frame), RK4 at 31 us with the voltage
held for 125 us as an inverter does, so that the mean voltage over any interval is exact.
Speed PI over a current controller that knows the true state. numba, which no product of ours needs,
makes a minute of what takes half an hour without.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp

R_S, L_S, PSI, POLES, INERTIA, K_P = 0.28, 3.465e-3, 0.1989, 4.0, 0.04, 1.5
TICK_S = 125e-6


class Machine(NamedTuple):
    """A motor and the currents its control works with; the bench motor of paper `adhesion`."""

    R_s: float = R_S
    L_s: float = L_S
    psi: float = PSI
    poles: float = POLES
    inertia: float = INERTIA
    most_a: float = 40.0
    a_per_rad_s: float = 0.5


BENCH = Machine()
KW_350 = Machine(R_s=0.08, L_s=3.02e-3, psi=1.104, poles=2.0, inertia=11.0, most_a=385.0,
                 a_per_rad_s=40.0)  # fmt: skip


class Truth(NamedTuple):
    """Each (T, N): at the end of tick k; u is held during it. Currents and voltages complex."""

    u: np.ndarray
    i: np.ndarray
    w: np.ndarray
    theta: np.ndarray
    load: np.ndarray


class Rows(NamedTuple):
    """Samples as a bus delivers them, in the estimators' row layout, and where they lie."""

    drive: np.ndarray
    u: np.ndarray
    y: np.ndarray
    n_sub: np.ndarray
    n_gap: np.ndarray
    tick: np.ndarray


@njit
def _rates(m, i_d, i_q, w, u_d, u_q, load):
    d_d = (u_d - m.R_s * i_d) / m.L_s + w * i_q
    d_q = (u_q - m.R_s * i_q - w * m.psi) / m.L_s - w * i_d
    d_w = m.poles / m.inertia * (K_P * m.poles * m.psi * i_q - load)
    return d_d, d_q, d_w


@njit
def _rotor_step(m, i_d, i_q, w, theta, u_a, u_b, load, dt):
    """RK4 with the stationary-frame voltage constant."""
    k = np.zeros((4, 4))
    for s in range(4):
        h = 0.0 if s == 0 else (dt if s == 3 else 0.5 * dt)
        r = max(s - 1, 0)
        angle = theta + h * k[r, 3]
        u_d = u_a * math.cos(angle) + u_b * math.sin(angle)
        u_q = u_b * math.cos(angle) - u_a * math.sin(angle)
        speed = w + h * k[r, 2]
        k[s, 0], k[s, 1], k[s, 2] = _rates(
            m, i_d + h * k[r, 0], i_q + h * k[r, 1], speed, u_d, u_q, load
        )
        k[s, 3] = speed
    out = (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3]) * (dt / 6.0)
    return i_d + out[0], i_q + out[1], w + out[2], theta + out[3]


@njit
def _run(m, w_0, theta_0, w_ref, load, u_out, i_out, w_out, theta_out):
    ticks, drives = w_ref.shape
    for n in range(drives):
        i_d, i_q, w, theta = 0.0, 0.0, w_0[n], theta_0[n]
        integral = 0.0
        for t in range(ticks):
            error = w_ref[t, n] - w
            step = 16.0 * m.a_per_rad_s * error * TICK_S
            integral = min(max(integral + step, -m.most_a), m.most_a)
            i_ref = min(max(m.a_per_rad_s * error + integral, -m.most_a), m.most_a)
            # A quarter of the deadbeat step; the rotor moves on by w T / 2 meanwhile.
            gain = 0.25 * m.L_s / TICK_S
            u_d = m.R_s * i_d - w * m.L_s * i_q - gain * i_d
            u_q = m.R_s * i_q + w * (m.L_s * i_d + m.psi) + gain * (i_ref - i_q)
            middle = theta + 0.5 * w * TICK_S
            u_a = u_d * math.cos(middle) - u_q * math.sin(middle)
            u_b = u_d * math.sin(middle) + u_q * math.cos(middle)
            for _ in range(4):
                i_d, i_q, w, theta = _rotor_step(
                    m, i_d, i_q, w, theta, u_a, u_b, load[t, n], 0.25 * TICK_S
                )
            u_out[t, n] = complex(u_a, u_b)
            i_out[t, n] = complex(i_d, i_q) * complex(math.cos(theta), math.sin(theta))
            w_out[t, n] = w
            theta_out[t, n] = theta


def motor(w_0, theta_0, w_ref, load, machine=BENCH):
    """Run N drives from speeds w_0 (N,) and angles theta_0 (N,) along w_ref, load (T, N)."""
    shape = w_ref.shape
    u, i = np.empty(shape, complex), np.empty(shape, complex)
    w, theta = np.empty(shape), np.empty(shape)
    _run(machine, np.asarray(w_0, float), np.asarray(theta_0, float), w_ref, load, u, i, w, theta)
    return Truth(u, i, w, theta, load)


def sampled(truth, every, noise_var, seed, lost=0.0):
    """What arrives: a sample every `every` ticks with noise, quantised, some lost.

    2 ms and slower: 0.02 A and 0.1 V as on the classic bus; below: 0.05 A and 0.25 V.
    """
    rng = np.random.default_rng(seed)
    i_lsb, u_lsb = (0.02, 0.1) if every >= 16 else (0.05, 0.25)
    ticks, drives = truth.w.shape
    count = ticks // every
    u = truth.u[: count * every].reshape(count, every, drives).mean(axis=1)
    y = truth.i[every - 1 : count * every : every]
    u = np.stack([u.real, u.imag], axis=-1)
    y = np.stack([y.real, y.imag], axis=-1)
    y = y + rng.normal(scale=math.sqrt(noise_var), size=y.shape)
    u = np.round(u / u_lsb) * u_lsb
    y = np.round(y / i_lsb) * i_lsb
    here = rng.random((count, drives)) >= lost
    k = np.arange(count)[:, None]
    last = np.maximum.accumulate(np.where(here, k, -1), axis=0)
    before = np.vstack([np.full((1, drives), -1), last[:-1]])
    gap = (k - 1 - before) * every
    drive = np.broadcast_to(np.arange(drives, dtype=np.int32), (count, drives))
    return Rows(
        drive[here].copy(),
        u[here],
        y[here],
        np.full(np.count_nonzero(here), every, dtype=np.int64),
        gap[here].astype(np.int64),
        np.broadcast_to((k + 1) * every - 1, (count, drives))[here].copy(),
    )


def test_the_motor_follows_its_equations():
    """Free run under constant voltage: the same as scipy in the stationary frame."""
    u_a, u_b, load = 20.0, -5.0, 3.0

    def rates(_, s):
        i_a, i_b, w, theta = s
        return [
            (u_a - R_S * i_a + PSI * w * math.sin(theta)) / L_S,
            (u_b - R_S * i_b - PSI * w * math.cos(theta)) / L_S,
            POLES
            / INERTIA
            * (K_P * POLES * PSI * (i_b * math.cos(theta) - i_a * math.sin(theta)) - load),
            w,
        ]

    theta_0, w_0 = 0.7, 80.0
    want = solve_ivp(rates, (0.0, 0.02), [0.0, 0.0, w_0, theta_0], rtol=1e-10, atol=1e-10).y[:, -1]
    i_d, i_q, w, theta = 0.0, 0.0, w_0, theta_0
    for _ in range(640):
        i_d, i_q, w, theta = _rotor_step(BENCH, i_d, i_q, w, theta, u_a, u_b, load, 0.25 * TICK_S)
    i = complex(i_d, i_q) * complex(math.cos(theta), math.sin(theta))
    assert [i.real, i.imag, w, theta] == pytest.approx(want, abs=1e-7)


def test_samples_account_for_every_tick():
    truth = motor([50.0], [0.0], np.full((1600, 1), 50.0), np.zeros((1600, 1)))
    rows = sampled(truth, 16, 0.0, seed=3, lost=0.3)
    assert len(rows.drive) < 100
    assert np.cumsum(rows.n_sub + rows.n_gap).tolist() == (rows.tick + 1).tolist()
    assert np.abs(truth.w[-1] - 50.0) < 0.5
