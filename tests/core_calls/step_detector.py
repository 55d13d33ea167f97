"""The step detector over whole records: `estimators/thermal/step_detector.c`."""

from __future__ import annotations

import numpy as np
from _traction_core import lib

from dbc.arrays import Array
from dbc.records import pointer
from estimators.thermal.step_detector import MOST_SAMPLES, SLOWEST_S, config, window


def offsets(residual: Array, spacing_s: float, noise_k: float = 0.0) -> Array:
    """(K, M, 3) K: how far each sensor has stepped, by what was seen until then.

    residual (K, M, 3) K, NaN without a reading; spacing_s: between samples; 0 if that is more than
    `SLOWEST_S`; noise_k: of a reading. Raises ValueError where more than `MOST_SAMPLES` are to be
    looked at.
    """
    out = np.zeros_like(residual)
    if spacing_s > SLOWEST_S:
        return out
    found = config(spacing_s, noise_k=noise_k)
    if window(found) > MOST_SAMPLES:
        raise ValueError(f"samples {spacing_s} s apart are too close together for steps")
    for m, p in np.ndindex(*residual.shape[1:]):
        given, own = np.ascontiguousarray(residual[:, m, p]), np.empty(len(residual))
        lib.step_follow(
            pointer("struct step_config", found), pointer("double", given), len(given),
            pointer("double", own),
        )  # fmt: skip
        out[:, m, p] = own
    return out
