"""Moving average inter-state standard deviation: paper `thermal`, eq. (29)-(31).

The rules are in `estimators/maisd.c`; this module applies them to arrays of motors and points.
"""

from __future__ import annotations

import numpy as np
from _traction_core import ffi, lib

from dbc.arrays import Array, Flags
from dbc.records import pointer


def window(samples: int, motors: int, points: int) -> Array:
    """(samples, motors, points) K: an empty window, NaN throughout."""
    return np.full((samples, motors, points), np.nan)


def compare(mean: Array, known: Flags) -> tuple[Array, Array]:
    """(31): spread (P,) K over the known motors, NaN for fewer than 2; deviation (M, P) K.

    mean: (M, P) centred window averages, K. The deviation of each known motor is taken from the
    median of the *other* known ones, because the fault itself pulls the mean; NaN without others.
    """
    motors, points = mean.shape
    spread, deviation = np.empty(points), np.empty(mean.shape)
    given = np.ascontiguousarray(mean, dtype=np.float64)
    of_all = np.ascontiguousarray(known, dtype=np.bool_)
    lib.maisd_compare(
        pointer("double", given), pointer("uint8_t", of_all), motors, points,
        ffi.new("double[]", motors), pointer("double", spread), pointer("double", deviation),
    )  # fmt: skip
    return spread, deviation
