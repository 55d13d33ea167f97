"""Moving average inter-state standard deviation: paper `thermal`, eq. (29)-(31).

The rules are in `estimators/maisd.c`; here they are for arrays of motors and points.
"""

from __future__ import annotations

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from estimators._core import pointer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def window(samples: int, motors: int, points: int) -> Array:
    """(samples, motors, points) K: an empty window, NaN throughout."""
    return np.full((samples, motors, points), np.nan)


def push(ring: Array, seen: int, values: Array, present: Flags) -> None:
    """Put the next sample, values (M, P) K where `present`, into the window, in place.

    seen: samples that were put in before.
    """
    samples, cells = len(ring), ring[0].size
    given = np.ascontiguousarray(values, dtype=np.float64)
    there = np.ascontiguousarray(present, dtype=np.bool_)
    lib.maisd_push(
        pointer("double", ring), samples, cells, seen, pointer("double", given),
        pointer("uint8_t", there),
    )  # fmt: skip


def average(ring: Array) -> tuple[Array, Flags]:
    """(29): means (M, P) K, and whether each is known: at least half a full window present."""
    mean, known = np.empty(ring.shape[1:]), np.empty(ring.shape[1:], dtype=np.bool_)
    number = np.empty(mean.shape, dtype=np.int64)
    lib.maisd_average(
        pointer("double", ring), len(ring), mean.size, pointer("double", mean),
        pointer("int64_t", number), pointer("uint8_t", known),
    )  # fmt: skip
    return mean, known


def compare(mean: Array, known: Flags) -> tuple[Array, Array]:
    """(31): spread (P,) K over the known motors, NaN of fewer than 2; deviation (M, P) K.

    mean: (M, P) centred window averages, K. The deviation is that of each known motor from the
    median of the *other* known ones, NaN without one: the plain mean is pulled by the fault itself.
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
