"""Steps of sensors: nothing of 850 kg warms by kelvins within seconds.

A sensor's residual (reading less model) is looked at through medians: of the last seconds against
those before. Where they part by more than `STEP_K`, the medians are compared once more when what
follows has settled: a burst is over by then, a step is not. Steps add up to how far the sensor is
off; a step back to what it was is not a new fault. Only for readings that come every few seconds.
Not in paper `thermal`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimators.thermal._steps_kernels import follow

Array = NDArray[np.float64]

BEFORE_S, AFTER_S, SETTLED_S = 20.0, 5.0, 25.0
STEP_K: Final = 1.5
"""Of medians over seconds; eight times their noise if single readings have 0.25 K."""
BACK_K: Final = 1.0
"""A sensor that is off by less is where it was."""
HEAT_K_PER_S: Final = 0.1
"""Fastest that heat, unknown to the model, changes a level."""
SLOWEST_S: Final = 2.0
"""Readings further apart can tell no step from heat."""


def offsets(residual: Array, spacing_s: float) -> Array:
    """(K, M, 3) K: how far each sensor has stepped, by what was seen until then.

    residual (K, M, 3) K, NaN without a reading; spacing_s: between samples; 0 if that is more than
    `SLOWEST_S`.
    """
    out = np.zeros_like(residual)
    if spacing_s <= SLOWEST_S:
        counts = np.array([round(s / spacing_s) for s in (BEFORE_S, AFTER_S, SETTLED_S)])
        k = len(residual)
        follows = HEAT_K_PER_S * spacing_s
        follow(residual.reshape(k, -1), counts, STEP_K, BACK_K, follows, out.reshape(k, -1))
    return out
