"""Runs of the filters over arrays that they change in place: `filter_simd.c`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.records import Columns
from estimators.filters import noise_records, run, settings, unstarted
from estimators.models.pmsm import Noise


def sweep(
    kind: str, table: Array, noise: Noise, x: Array, P: Array, samples: Columns, dt: float,
    bias: Array | None = None, bits: int = 0,
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """Run filters over M samples; x (N, 5) and P (N, 5, 5) in place.

    kind: "ekf" or "ukf"; bias: v_q_bias (N,), V, none without. Returns (nis (M,), ok (N,)).
    """
    drives = unstarted(len(x))
    drives.x, drives.P, drives.v_q_bias = x, P, 0.0 if bias is None else bias
    run(samples, table, noise_records(noise), drives, settings(dt, kind), bits)
    x[:], P[:] = drives.x, drives.P
    return samples.nis.copy(), drives.is_finite == 1
