"""The window of `estimators/maisd.c`, sample by sample."""

from __future__ import annotations

import numpy as np
from _traction_core import lib

from dbc.arrays import Array, Flags
from dbc.records import pointer


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
