"""The step detector over whole records: `estimators/thermal/step_detector.c`."""

from __future__ import annotations

import numpy as np
from _traction_core import ffi, lib

from estimators._core import pointer
from estimators.thermal.step_detector import MOST_SAMPLES, SLOWEST_S, Array, config, window


def offsets(residual: Array, spacing_s: float) -> Array:
    """(K, M, 3) K: how far each sensor has stepped, by what was seen until then.

    residual (K, M, 3) K, NaN without a reading; spacing_s: between samples; 0 if that is more than
    `SLOWEST_S`. Raises ValueError where more than `MOST_SAMPLES` are to be looked at.
    """
    out = np.zeros_like(residual)
    if spacing_s > SLOWEST_S:
        return out
    found = config(spacing_s)
    if window(found) > MOST_SAMPLES:
        raise ValueError(f"samples {spacing_s} s apart are too close together for steps")
    size = window(found)
    for m, p in np.ndindex(*residual.shape[1:]):
        state = ffi.new("struct step_state *")
        lib.step_reset(state)
        latest = np.full(size, np.nan)
        for k, value in enumerate(residual[:, m, p]):
            latest[:-1], latest[-1] = latest[1:].copy(), value
            if k >= found["before"][0] + found["after"][0]:
                lib.step_add_sample(
                    pointer("struct step_config", found), state, pointer("double", latest)
                )
            out[k, m, p] = state.offset_k
    return out
