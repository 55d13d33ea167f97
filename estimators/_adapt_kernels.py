"""Compiled loop over a tick's innovations; `adapt.scale` itself is what runs in it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators import adapt

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Drives = NDArray[np.int32] | NDArray[np.int64]

_scale = njit(cache=True)(adapt.scale)


@njit(cache=True)
def absorb(
    drive: Drives,
    nis: Array,
    n_sub: Ints,
    dt: float,
    smoothing: float,
    active: NDArray[np.bool_],
    steps: Ints,
    mean: Array,
    scale: Array,
) -> None:
    """M innovations in order, of N drives: counts steps, smooths the NIS, scales R.

    drive, nis, n_sub (M,): as in `ekf_sweep`, NaN where a row was skipped; dt: sub-step, s.
    Changes steps (N,) in sub-steps since the start, mean and scale (N,) of the `active` drives.
    """
    for k in range(drive.shape[0]):
        d = drive[k]
        if not active[d]:
            continue
        steps[d] += n_sub[k]
        if math.isfinite(nis[k]):
            mean[d] += smoothing * (nis[k] - mean[d])
            scale[d] = _scale(scale[d], nis[k], n_sub[k] * dt, steps[d] * dt)
