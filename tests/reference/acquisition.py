"""Flux chords in Python: what `estimators/acquisition.c` is compared with.

The state is that of the C, one record per drive; sines and logarithms are those of libm.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.models.pmsm import T_L, THETA_E, W_E, Noise, Pmsm, Rated
from tests.core_calls.acquisition import Consistency
from tests.reference import motor_model

IMPLAUSIBLE = 1e5
W_TOL, W_TOL_RELATIVE, THETA_TOL, STILL_TOL = 20.0, 0.5, 0.8, 40.0


class Tuning(NamedTuple):
    """When the chords are believed. Speeds are electrical, rad/s."""

    chord_steps: int = 16
    turn_long: float = 1.5
    turn_short: float = 0.9
    settle: int = 4
    forget: float = 0.92
    forget_angle: float = 0.5
    chords: int = 20
    w_on: float = 20.0
    w_off: float = 15.0
    coherence: float = 0.9
    length_tol: float = 0.35
    turn_max: float = 2.5
    step_turn_max: float = 0.63
    hold: float = 10.0


def add(
    par: Array, state: Any, tuning: Tuning, drive: Array, u: Array, y: Array, n_sub: Array,
    n_gap: Array, dt: float,
) -> None:  # fmt: skip
    """Feed M samples to the chord sums of `lock`; `state` in place. Never raises on numbers.

    par (N, 7) as `pmsm.table`. A sample that is not finite, or that no motor has,
    breaks the chord it falls into.
    """
    for k in range(drive.shape[0]):
        d = drive[k]
        i_k = complex(y[k, 0], y[k, 1])
        u_k = complex(u[k, 0], u[k, 1])
        tau = n_sub[k] * dt
        # Written so that NaN is none.
        finite = abs(y[k, 0]) + abs(y[k, 1]) + abs(u[k, 0]) + abs(u[k, 1]) < IMPLAUSIBLE
        gap = n_gap[k] * dt
        state.age[d] += gap + tau
        if not finite or state.steps[d] < 0 or gap > 0.0:
            # No chord across a hole; the next one starts at the end of this sample.
            state.paired_steps[d] = 0
            state.flux[d] = 0.0
            state.steps[d] = 0 if finite else -1
            if finite:
                state.i_start[d] = i_k
                state.i_last[d] = i_k
            if state.age[d] > tuning.hold * max(state.span[d], tuning.chord_steps * dt):
                state.good[d] = 0
                state.pairs[d] = 0
                state.ready[d] = False
                # Nobody knows how fast it turns by now: from the shortest chord again.
                state.stride[d] = 1
            continue
        state.flux[d] += (u_k - 0.5 * par[d, 0] * (state.i_last[d] + i_k)) * tau
        state.i_last[d] = i_k
        state.steps[d] += n_sub[k]
        if state.steps[d] < state.stride[d]:
            continue
        steps = state.steps[d]
        chord = state.flux[d] - par[d, 1] * (i_k - state.i_start[d])
        before = state.chord[d]
        paired = state.paired_steps[d] == steps
        state.i_start[d] = i_k
        state.flux[d] = 0.0
        state.steps[d] = 0
        state.chord[d] = chord
        state.paired_steps[d] = steps
        if paired:
            _add_pair(par[d, 2], state, tuning, d, chord, before, steps, dt)
            turn = abs(state.w[d]) * state.span[d]
            if state.pairs[d] < tuning.settle:
                continue
            if turn > tuning.turn_long and steps > n_sub[k]:
                state.stride[d] = steps // 2
            elif 2 * steps <= tuning.chord_steps:
                longest = state.w_max[d] * state.span[d]
                state.stride[d] = 2 * steps if longest <= tuning.turn_short else steps


def _resize(state: Any, d: int, ratio: float) -> None:
    """The means as chords of `ratio` (2 or 1/2) times the length would have made them."""
    S1, S2 = state.S1[d], state.S2[d]
    turn = math.atan2(S1.imag, S1.real)
    slow = math.atan2(S2.imag, S2.real)
    # |c| = 2 psi |sin(turn / 2)|.
    cos = math.cos(0.5 * turn) if ratio > 1.0 else math.cos(0.25 * turn)
    grow = 4.0 * cos * cos if ratio > 1.0 else 0.25 / (cos * cos)
    state.S0[d] *= grow
    state.S1[d] = abs(S1) * grow * complex(math.cos(ratio * turn), math.sin(ratio * turn))
    state.S2[d] = abs(S2) * grow * complex(math.cos(ratio * slow), math.sin(ratio * slow))
    state.span[d] *= ratio


def _add_pair(
    psi_f: float, state: Any, tuning: Tuning, d: int, chord: complex, before: complex, steps: int,
    dt: float,
) -> None:  # fmt: skip
    """One more pair of consecutive chords, each `steps` of dt: sums, speed, angle, ready."""
    span = steps * dt
    if state.ready[d] and span != state.span[d]:
        ratio = span / state.span[d]
        if ratio in (0.5, 2.0):
            _resize(state, d, ratio)
    pair = chord * before.conjugate()
    energy = 0.5 * (abs(chord) ** 2 + abs(before) ** 2)
    if state.pairs[d] == 0 or state.span[d] != span:
        state.S1[d] = pair
        state.S2[d] = pair
        state.S0[d] = energy
        state.turned_sum[d] = 0.0
        state.pairs[d] = 0
        state.good[d] = 0
        state.ready[d] = False
        state.span[d] = span
    state.pairs[d] += 1
    # A plain mean at first, so that the first pair does not outweigh the others.
    keep = min(tuning.forget, 1.0 - 1.0 / state.pairs[d])
    state.S1[d] = keep * state.S1[d] + (1.0 - keep) * pair
    state.S2[d] = keep * state.S2[d] + (1.0 - keep) * state.S1[d]
    state.S0[d] = keep * state.S0[d] + (1.0 - keep) * energy
    S1, S2, S0 = state.S1[d], state.S2[d], state.S0[d]
    if not math.isfinite(S0 + S1.real + S1.imag + S2.real + S2.imag):
        # Finite input can still overflow its square; the next pair starts anew.
        state.pairs[d] = 0
        state.ready[d] = False
        return
    # The first sum lags an acceleration; its distance from the second says by how much.
    lagging = math.atan2(S1.imag, S1.real)
    slope = S1 * S2.conjugate()
    turn = lagging + math.atan2(slope.imag, slope.real) / tuning.forget
    w = turn / span
    # After a hole the mean is older than one chord: begin with the chord before this one.
    older = state.turned_sum[d] if state.age[d] < 1.5 * span else before
    rotated = older * complex(math.cos(turn), math.sin(turn))
    state.turned_sum[d] = tuning.forget_angle * rotated + chord
    mean = state.turned_sum[d]
    quarter = 0.5 * math.pi if turn >= 0.0 else -0.5 * math.pi
    state.theta[d] = motor_model.wrap(math.atan2(mean.imag, mean.real) - quarter + 0.5 * turn)
    state.w[d] = w
    state.age[d] = 0.0

    coherence = abs(S1) / S0 if S0 > 0.0 else 0.0
    state.spread[d] = math.sqrt(-2.0 * math.log(min(max(coherence, 1e-12), 1.0)))
    length = math.sqrt(S0)
    half_sine = abs(math.sin(0.5 * lagging))
    expected = 2.0 * psi_f * half_sine
    state.psi[d] = length / (2.0 * half_sine) if half_sine > 0.0 else math.nan
    sine = length / (2.0 * psi_f * (1.0 - tuning.length_tol))
    state.w_max[d] = 2.0 / span * math.asin(sine) if sine < 1.0 else math.inf
    sudden = 2.0 * psi_f * abs(math.sin(0.5 * turn))
    slowest = psi_f * tuning.w_off * span
    plausible = (
        coherence >= tuning.coherence
        and abs(length - expected) <= tuning.length_tol * expected
        and abs(turn) <= tuning.turn_max
        and abs(w) * dt <= tuning.step_turn_max
        and abs(lagging) >= tuning.w_off * span
        # The means remember, the last chord does not: it must be long enough for a rotor that
        # turns, and fit the speed, or a hard brake or a reversal slips through.
        and abs(chord) >= (1.0 - tuning.length_tol) * slowest
        and abs(abs(chord) - sudden) <= tuning.length_tol * sudden + slowest
    )
    state.good[d] = state.good[d] + 1 if plausible else 0
    if state.good[d] == 0:
        state.ready[d] = False
    elif state.good[d] >= tuning.chords and abs(lagging) >= tuning.w_on * span:
        state.ready[d] = True


def theta(state: Any) -> Array:
    """At the last sample, the speed constant since the last chord."""
    return motor_model.wrap(state.theta + state.w * state.age)


def check(state: Any, x: Array) -> list[int]:
    """`Consistency` of each drive's filter state x (N, 5) with its chords."""
    tuning = Tuning()
    w = x[:, W_E]
    with np.errstate(invalid="ignore"):
        same_w = np.abs(w - state.w) <= W_TOL + W_TOL_RELATIVE * np.abs(state.w)
        same_theta = np.abs(motor_model.wrap(x[:, THETA_E] - theta(state))) <= THETA_TOL
        runaway = (state.pairs >= tuning.chords) & (np.abs(w) > state.w_max + STILL_TOL)
    ready = np.where(same_w & same_theta, Consistency.CONSISTENT, Consistency.INCONSISTENT)
    unready = np.where(runaway, Consistency.INCONSISTENT, Consistency.UNKNOWN)
    verdict = np.where(state.ready == 1, ready, unready)
    return np.where(np.isfinite(x).all(axis=1), verdict, Consistency.INCONSISTENT).tolist()


def start_states(state: Any, par: Pmsm, noise: Noise, rated: Rated) -> tuple[Array, Array]:
    """First x (N, 5) and P (N, 5, 5) of filters from the chords."""
    ready = state.ready == 1
    x = np.stack([state.i_last.real, state.i_last.imag, state.w, theta(state), 0.0 * state.w], 1)
    x[:, T_L] = motor_model.torque(par, x)
    spread = np.where(ready, state.spread, 1.0)
    span = np.where(ready, state.span, 1.0)
    deviation_w = 5.0 + 0.1 * np.abs(state.w) + 0.3 * spread / span
    variance = [noise.R[:, 0], noise.R[:, 1], deviation_w**2, (0.1 + spread) ** 2, rated.T**2]
    return x, np.stack(variance, axis=1)[:, :, None] * np.eye(5)
