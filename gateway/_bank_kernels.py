"""Compiled judgement of the bank: which filter is dropped, begins, is believed. Own twins.

Scalar by nature, a loop over drives, so the twin is the same function uncompiled (`.py_func`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean
from dbc.records import ACQUISITION, FILTER

if TYPE_CHECKING:
    from dbc.records import Columns
    from gateway.tracks import Limits, Told, Tracks

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_W_E, _T_L = 2, 4  # pmsm
_AGREES, _DISAGREES = 1, 2  # enum consistency
_CHORDS, _FILTER = ACQUISITION.itemsize, FILTER.itemsize
_check, _reset = symbol("acquisition_check"), symbol("filter_reset")
_UNKNOWN, _CONVERGING, _TRACKING, _PREDICTING, _DIVERGED, _INPUT_INVALID = range(6)  # Health
_CORRUPTED, _SEQUENCE, _RANGE, _NOT_AVAILABLE = 3, 4, 5, 6  # Reason
_STANDS, _BEGINS, _GONE = 0, 1, 2
"""A drive in this tick: as it was; to be started; said to have diverged."""


@inlined
def forget(k: int, filters: Columns, tracks: Tracks) -> None:
    """No filter of drive k any more; it is acquired anew."""
    _reset(filters.ctypes.data + int(k) * _FILTER)
    tracks.doubts[k] = 0


@lean
def drop_over_holes(
    drive: NDArray[np.int32], steps: Ints, gap: Ints, most: int, filters: Columns, tracks: Tracks
) -> None:
    """Filters that cannot bridge what is missing begin anew; one sample they always can.

    most: sub-steps that any filter bridges.
    """
    for i in range(drive.shape[0]):
        if gap[i] > max(steps[i], most):
            forget(drive[i], filters, tracks)


@inlined
def _note_moves(drive: NDArray[np.int32], filters: Columns, tracks: Tracks) -> None:
    """Whose load has been moving, and who has said nothing in this tick."""
    for k in range(tracks.silent.shape[0]):
        tracks.silent[k] = True
    for i in range(drive.shape[0]):
        tracks.silent[drive[i]] = False
    for k in range(tracks.silent.shape[0]):
        if not tracks.silent[k]:
            load = filters.x[k, _T_L]
            tracks.moved[k] = abs(load - tracks.load[k])
            tracks.load[k] = load


@inlined
def _note_flux(chords: Columns, limits: Limits, tracks: Tracks) -> None:
    """Magnet flux over that of the data sheet, as the chords' length has it of late.

    Errors of R_s lengthen a chord, too: what they can explain is not taken for flux. The
    chords reach further than the filters, and what they found survives a new start.
    """
    for k in range(tracks.flux.shape[0]):
        psi, w, psi_f = chords.psi[k], chords.w[k], limits.psi_f[k]
        if not chords.ready[k] or not math.isfinite(psi) or w == 0.0:
            continue
        unsure = limits.resistance_sure * limits.R_s[k] * abs(chords.i_last[k]) / abs(w)
        sure = limits.flux_sure * psi_f + unsure
        more = math.copysign(max(abs(psi - psi_f) - sure, 0.0), psi - psi_f) / psi_f
        before = more if math.isnan(tracks.flux[k]) else tracks.flux[k] - 1.0
        tracks.flux[k] = 1.0 + before + limits.flux_near * (more - before)


@inlined
def _next(
    k: int, now: int, agrees: int, fresh: bool, chords: Columns, filters: Columns,
    tracks: Tracks, limits: Limits,
) -> int:  # fmt: skip
    """What becomes of drive k in this tick: _STANDS, _BEGINS or _GONE."""
    steps = filters.steps[k]
    if steps < 0:
        filters.steps[k] = 0
        tracks.diverged_ns[k] = now
    if agrees == _DISAGREES and filters.active[k]:
        tracks.doubts[k] += 1
        if tracks.doubts[k] >= limits.disagree_ticks:
            forget(k, filters, tracks)
            filters.v_q_bias[k] = 0.0
            # A start that does not settle is tried again; a lost lock is a divergence.
            if steps >= limits.settle_steps:
                tracks.diverged_ns[k] = now
    else:
        tracks.doubts[k] = 0
    diverged = tracks.diverged_ns[k]
    if diverged >= 0 and now - diverged < limits.diverged_ns:
        return _GONE
    # The chords know speed and angle from the very last samples.
    seen = chords.ready[k] and chords.age[k] < 2.0 * chords.span[k]
    return _BEGINS if fresh and seen and not filters.active[k] else _STANDS


@inlined
def _tell(
    k: int, cause: int, fresh: bool, agrees: int, filters: Columns, tracks: Tracks,
    limits: Limits, told: Told,
) -> int:  # fmt: skip
    """Health of drive k; fills its numbers where a filter has any."""
    told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan
    if cause in (_CORRUPTED, _SEQUENCE, _RANGE, _NOT_AVAILABLE):
        return _INPUT_INVALID
    # A load that moves is not the load of a tick ago.
    if tracks.silent[k] and tracks.moved[k] > limits.moving_nm[k]:
        fresh = False
    if not filters.active[k]:
        return _CONVERGING if fresh else _UNKNOWN
    sigma = math.sqrt(filters.P[k, _T_L, _T_L])
    flux = 1.0 if math.isnan(tracks.flux[k]) else tracks.flux[k]
    told.speed[k] = filters.x[k, _W_E] / limits.pole_pairs[k]
    told.load[k] = filters.x[k, _T_L] * flux
    told.sigma[k] = sigma * flux
    told.nis[k] = filters.nis[k]
    if not fresh:
        return _PREDICTING
    if filters.steps[k] < limits.settle_steps or agrees != _AGREES:
        return _CONVERGING
    tracks.best[k] = min(limits.forget * tracks.best[k], sigma)
    return _CONVERGING if sigma > limits.loose * tracks.best[k] else _TRACKING


@lean
def follow(
    drive: NDArray[np.int32],
    now: int,
    inputs: Bytes,
    fresh: Flags,
    chords: Columns,
    filters: Columns,
    tracks: Tracks,
    limits: Limits,
    told: Told,
) -> bool:
    """After the filters' loop: drops, divergences, and what each drive is told to be.

    drive (M,): of this tick's samples; inputs (N,):
    `Reason` why an input cannot be believed; fresh (N,): its newest sample is within its limit.
    Fills `told`. True where a filter has to begin: it is marked in `told.begins`, and is told
    by `tell` once it has begun.
    """
    any_begins = False
    for k in range(fresh.shape[0]):
        if not filters.is_finite[k]:
            # Reset now, said from this tick on.
            active = filters.active[k]
            forget(k, filters, tracks)
            filters.v_q_bias[k] = 0.0
            filters.steps[k] = -1 if active else 0
    _note_moves(drive, filters, tracks)
    _note_flux(chords, limits, tracks)
    for k in range(fresh.shape[0]):
        if filters.active[k] and chords.pairs[k] < limits.pairs:
            # The chords have begun anew, and the filter with its only witness.
            forget(k, filters, tracks)
    for k in range(fresh.shape[0]):
        told.agrees[k] = _check(chords.ctypes.data + k * _CHORDS, filters.ctypes.data + k * _FILTER)
        agrees = told.agrees[k]
        what = _next(k, now, agrees, fresh[k], chords, filters, tracks, limits)
        told.begins[k] = what == _BEGINS
        if what == _BEGINS:
            any_begins = True
        elif what == _GONE:
            told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan
            told.health[k] = _DIVERGED
        else:
            told.health[k] = _tell(k, inputs[k], fresh[k], agrees, filters, tracks, limits, told)
    return any_begins


@lean
def tell(
    inputs: Bytes, fresh: Flags, filters: Columns, tracks: Tracks, limits: Limits, told: Told
) -> None:
    """Fills `told` for the drives that have just begun; their chords agree with them."""
    for k in range(told.begins.shape[0]):
        if told.begins[k]:
            told.health[k] = _tell(k, inputs[k], fresh[k], _AGREES, filters, tracks, limits, told)
