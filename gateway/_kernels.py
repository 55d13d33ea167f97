"""Compiled row loop of the inbox: validity of decoded rows, pairing of halves, sample gaps.

Scalar by nature, so its twin is the same function uncompiled (`take_rows.py_func`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gateway.pairing import PairState, Samples, Wiring

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

_NOT_AVAILABLE, _ABSENT = 1, 4  # dbc.spec
_CURRENTS, _VOLTAGES, _BLOCK = 0, 1, 2  # pairing.Kind
_GOOD, _MISSING, _OUTSIDE = 0, 1, 2  # pairing.Row
_UNPAIRED, _LATE, _ANY = 0, 1, 2  # pairing.Trouble
_SQRT3 = math.sqrt(3.0)
_SUM_SMOOTHING = 0.05


@njit(cache=True)
def _verdict(row: int, c: int, wiring: Wiring, value: Array, validity: Bytes) -> int:
    """Whether every signal of a row may be used, and if not why."""
    quality = wiring.quality[c]
    missing = quality >= 0 and value[row, quality] != 1.0 and value[row, quality] != 2.0
    outside = False
    for k in range(wiring.width[c]):
        v = validity[row, k]
        if v == _NOT_AVAILABLE:
            missing = True
        elif v not in (0, _ABSENT):
            outside = True
    if missing:
        return _MISSING
    return _OUTSIDE if outside else _GOOD


@njit(cache=True)
def _gap(
    state: PairState, d: int, counter: int, modulus: int, t: int, period: int, hole: int
) -> int:
    """Cycles missing before this sample; -1 if it is not newer than the last, -2 to start anew.

    The counter says how many cycles have passed, the stamps only which turn of it.
    """
    last = state.sample_ns[d]
    if last < 0 or t - last > hole:
        return -2
    delta = (counter - state.sequence[d]) % modulus
    turns = round(((t - last) / period - delta) / modulus)
    cycles = int(delta + modulus * turns)
    return cycles - 1 if cycles > 0 else -1


@njit(cache=True)
def take_rows(
    channel: Ints,
    t_ns: Ints,
    payload: Bytes,
    value: Array,
    validity: Bytes,
    wiring: Wiring,
    hole_ns: int,
    state: PairState,
    verdict: Bytes,
    out: Samples,
) -> int:
    """Judge R decoded rows and turn the electrical ones into samples; returns their number.

    channel (R,), t_ns (R,), payload (R, 64), value and validity (R, S) as `Codec.decode_rows`;
    `wiring` has a row per channel, `state` a row per drive. Fills verdict (R,) and the rows of
    `out` (at least 8 R long). A drive that starts anew is marked in `state.restart`.
    """
    m = 0
    for r in range(channel.shape[0]):
        c = channel[r]
        verdict[r] = _verdict(r, c, wiring, value, validity)
        kind = wiring.kind[c]
        if kind > _BLOCK or verdict[r] != _GOOD:
            continue
        d = wiring.drive[c]
        cols = wiring.columns[c]
        if kind == _BLOCK and int(value[r, cols[0]]) % 8:
            verdict[r] = _OUTSIDE
            continue
        period = wiring.period_ns[c]
        t = t_ns[r]
        counter = payload[r, 1] & 0x0F
        modulus = 16
        if kind == _BLOCK:
            counter = int(value[r, cols[0]]) // 8
            modulus = 8192
        else:
            mine = state.half[d, kind, counter]
            if kind == _CURRENTS:
                a, b, e = value[r, cols[0]], value[r, cols[1]], value[r, cols[2]]
                # A real motor's phases sum to nothing; a slow average forgives noise.
                state.sum_error[d] += _SUM_SMOOTHING * (abs(a + b + e) - state.sum_error[d])
                mine[0] = (2.0 * a - b - e) / 3.0
                mine[1] = (b - e) / _SQRT3
            else:
                mine[0] = value[r, cols[0]]
                mine[1] = value[r, cols[1]]
            state.half_ns[d, kind, counter] = t
            other = state.half_ns[d, 1 - kind, counter]
            if other < 0:
                continue
            if abs(other - t) > 8 * period:
                # The older half belongs to an earlier turn of the counter.
                older = 1 - kind if other < t else kind
                state.half_ns[d, older, counter] = -1
                state.trouble[_UNPAIRED] += 1
                state.trouble[_ANY] = 1
                continue
            state.half_ns[d, 0, counter] = -1
            state.half_ns[d, 1, counter] = -1
            t = max(t, other)
        missing = _gap(state, d, counter, modulus, t, period, hole_ns)
        if missing == -1:
            state.trouble[_LATE] += 1
            state.trouble[_ANY] = 1
            continue
        if missing == -2:
            state.restart[d] = True
            state.trouble[_ANY] = 1
            missing = 0
        state.sequence[d] = counter
        state.sample_ns[d] = t
        steps = wiring.steps[c]
        if kind != _BLOCK:
            out.drive[m] = d
            out.u[m] = state.half[d, _VOLTAGES, counter]
            out.y[m] = state.half[d, _CURRENTS, counter]
            out.steps[m] = steps
            out.gap[m] = missing * steps
            m += 1
            continue
        for k in range(8):
            a, b = value[r, cols[1 + 4 * k]], value[r, cols[2 + 4 * k]]
            out.drive[m] = d
            out.u[m, 0] = value[r, cols[3 + 4 * k]]
            out.u[m, 1] = value[r, cols[4 + 4 * k]]
            out.y[m, 0] = a
            out.y[m, 1] = (a + 2.0 * b) / _SQRT3
            out.steps[m] = 1
            out.gap[m] = 8 * missing if k == 0 else 0
            m += 1
    return m
