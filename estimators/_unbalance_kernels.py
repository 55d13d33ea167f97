"""Compiled loop of `unbalance`: scalar by nature, its twin is itself uncompiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators import lock, unbalance
from estimators._lean import lean
from estimators.unbalance import Unbalance

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32] | NDArray[np.int64]

_TURN = 2.0 * math.pi
_REVOLUTIONS = unbalance.REVOLUTIONS
_FOLLOW_S = unbalance.FOLLOW_S
_MOST_STEP = unbalance.MOST_STEP
_STEADY = unbalance.STEADY
_LEAST = unbalance.LEAST
_MOST_OFFSET = unbalance.MOST_OFFSET
_MOST_IMAGE = unbalance.MOST_IMAGE
_LEAST_VARIANCE = unbalance.LEAST_VARIANCE
_WILD = lock.WILD
_LINE_S = unbalance.LINE_S
_LINE_LEAST = unbalance.LINE_LEAST
_SUMS = 3
"""Kept over a revolution, of a current as a complex number: it, its square, its size squared."""

on_line = lean(unbalance.on_line)


@lean
def balance(
    state: Unbalance,
    drive: Drives,
    y: Array,
    n_sub: Ints,
    n_gap: Ints,
    dt: float,
    w_e: Array,
    ready: NDArray[np.bool_],
    rated: Array,
    out: Array,
) -> None:
    """Correct M samples by what is known so far, and learn from them.

    drive, y (M, 2), n_sub, n_gap, dt: as in `ekf_lanes`; w_e (N,): electrical speed, rad/s, where
    it is known (`ready`, (N,)); rated (N,) A; out (M, 2) is filled. Never raises on numbers: a
    sample that is not finite, or that no motor has (`lock.WILD`), stays what it is and begins the
    revolution anew.
    """
    for k in range(drive.shape[0]):
        d = drive[k]
        z = complex(y[k, 0], y[k, 1])
        near = min(n_sub[k] * dt / _FOLLOW_S, 1.0)
        state.offset_now[d] += near * (state.offset[d] - state.offset_now[d])
        state.image_now[d] += near * (state.image[d] - state.image_now[d])
        n = state.image_now[d]
        centred = z - state.offset_now[d]
        i = (centred - n * centred.conjugate()) / (1.0 - abs(n) ** 2)
        out[k, 0], out[k, 1] = i.real, i.imag
        fine = abs(z.real) + abs(z.imag) < _WILD  # written so that NaN is not
        if fine:
            _swing(state, d, z, (n_sub[k] + n_gap[k]) * dt, _LINE_LEAST * rated[d])
        step = abs(w_e[d]) * n_sub[k] * dt if ready[d] else 0.0
        if not (0.0 < step <= _MOST_STEP and n_gap[k] == 0 and fine):
            _begin(state, d)
            state.square[d] = 0.0
            continue
        left = _TURN - state.turned[d]
        _add(state, d, z, min(step, left))
        if step >= left:
            _finish(state, d, rated[d])
            for j in range(_SUMS):
                state.before[d, j] = state.rising[d, j]
            _begin(state, d)
            _add(state, d, z, step - left)


@lean
def _swing(state: Unbalance, d: int, z: complex, passed: float, least: float) -> None:
    near = min(passed / _LINE_S, 1.0)
    whole = max(z.real * z.real + z.imag * z.imag, least * least)
    state.line[d] += near * (z * z / whole - state.line[d])
    state.seen[d] += near * ((z.real * z.real + z.imag * z.imag) / whole - state.seen[d])
    state.step_s[d] = passed


@lean
def _begin(state: Unbalance, d: int) -> None:
    state.turned[d] = 0.0
    for j in range(_SUMS):
        state.flat[d, j] = 0.0
        state.rising[d, j] = 0.0


@lean
def _add(state: Unbalance, d: int, z: complex, angle: float) -> None:
    weight = angle * (state.turned[d] + 0.5 * angle) / _TURN
    state.turned[d] += angle
    square = z.real * z.real + z.imag * z.imag
    flat, rising = state.flat[d], state.rising[d]
    flat[0] += angle * z
    flat[1] += angle * z * z
    flat[2] += angle * square
    rising[0] += weight * z
    rising[1] += weight * z * z
    rising[2] += weight * square


@lean
def _finish(state: Unbalance, d: int, rated: float) -> None:
    """Learn from this revolution and the one before, if both are whole and alike."""
    now = state.flat[d, 2].real / _TURN
    last, state.square[d] = state.square[d], now
    if not (now >= (_LEAST * rated) ** 2 and abs(now - last) <= _STEADY * last):
        return
    # Up over the revolution before, down over this one: a triangle of area 2 pi.
    offset = (state.before[d, 0] + state.flat[d, 0] - state.rising[d, 0]) / _TURN
    second = (state.before[d, 1] + state.flat[d, 1] - state.rising[d, 1]) / _TURN
    square = (state.before[d, 2] + state.flat[d, 2] - state.rising[d, 2]) / _TURN
    variance = square.real - abs(offset) ** 2
    # A current that has not turned has none, to within the rounding of the sums: held samples.
    if not variance > _LEAST_VARIANCE * square.real:
        return
    image = 0.5 * (second - offset * offset) / variance
    if not (abs(offset) <= _MOST_OFFSET * rated and abs(image) <= _MOST_IMAGE):
        return
    state.turns[d] = min(state.turns[d] + 1, _REVOLUTIONS)
    state.offset[d] += (offset - state.offset[d]) / state.turns[d]
    state.image[d] += (image - state.image[d]) / state.turns[d]
