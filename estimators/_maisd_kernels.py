"""MAISD of the compiled core (`estimators/maisd.c`) for the loops that numba still compiles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators._core import symbol
from estimators._lean import inlined

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

_push, _average, _compare = (symbol(f"maisd_{name}") for name in ("push", "average", "compare"))


@inlined
def take(
    ring: Array, seen: int, values: Array, present: Flags, mean: Array, number: Ints, known: Flags
) -> None:
    """`maisd_push` and `maisd_average`: ring (s, M, P), all others (M, P); contiguous."""
    cells = mean.size
    _push(ring.ctypes.data, ring.shape[0], cells, seen, values.ctypes.data, present.ctypes.data)
    _average(
        ring.ctypes.data, ring.shape[0], cells, mean.ctypes.data, number.ctypes.data,
        known.ctypes.data,
    )  # fmt: skip


@inlined
def compare(mean: Array, known: Flags, ranked: Array, spread: Array, deviation: Array) -> None:
    """`maisd_compare`: fills spread (P,) and deviation (M, P); ranked (M,): workspace."""
    _compare(
        mean.ctypes.data, known.ctypes.data, mean.shape[0], mean.shape[1], ranked.ctypes.data,
        spread.ctypes.data, deviation.ctypes.data,
    )  # fmt: skip
