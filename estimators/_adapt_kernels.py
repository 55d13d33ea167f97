"""Compiled loop over a tick's innovations; `adapt.scale` itself is what runs in it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators import adapt
from estimators._lean import lean
from estimators.lock import LockState

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32] | NDArray[np.int64]

_scale = lean(adapt.scale)
_lean = lean(adapt.lean)
_most_lean = lean(adapt.most_lean)


@lean
def absorb(
    drive: Drives,
    nis: Array,
    n_sub: Ints,
    dt: float,
    smoothing: float,
    settled: int,
    par: Array,
    rated: Array,
    w_e: Array,
    chords: LockState,
    active: NDArray[np.bool_],
    steps: Ints,
    mean: Array,
    scale: Array,
    lean: Array,
) -> None:
    """M innovations in order, of N drives: counts steps, smooths the NIS, scales R, leans.

    drive, nis, n_sub (M,): as in `ekf_lanes`, NaN where a row was skipped; dt: sub-step, s;
    settled: sub-steps from which on the speed says something about the motor; par: as in
    `ekf_lanes`; rated: (N,) A; w_e (N,): the filters' speeds. Changes steps (N,) in sub-steps since
    the start, mean, scale and lean (N,) of the `active` drives.
    """
    for k in range(drive.shape[0]):
        d = drive[k]
        if not active[d]:
            continue
        steps[d] += n_sub[k]
        if math.isfinite(nis[k]):
            mean[d] += smoothing * (nis[k] - mean[d])
            scale[d] = _scale(scale[d], nis[k], n_sub[k] * dt, steps[d] * dt)
        if steps[d] >= settled and chords.ready[d]:
            most = _most_lean(w_e[d], par[d, 0], par[d, 2], rated[d])
            beyond = w_e[d] - chords.w[d]
            lean[d] = _lean(lean[d], beyond, par[d, 2], n_sub[k] * dt, most, steps[d] * dt)
