"""Acquisition of a rotor by its flux chords: `acquisition.c` for records of N drives.

The mathematics, its limits and its source stand in `acquisition.c`, the fields in
`gateway/core/records.h`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np
from _traction_core import ffi, lib

from dbc.arrays import Array
from dbc.records import ACQUISITION, ACQUISITION_LIMITS, Columns, pointer, zeros

PAIRS: Final = lib.ACQUISITION_PAIRS
"""Consecutive plausible pairs of chords before a drive is ready."""


class Consistency(IntEnum):
    """Of a filter with the chords: `enum consistency`."""

    UNKNOWN = lib.CONSISTENCY_UNKNOWN
    CONSISTENT = lib.CONSISTENT
    INCONSISTENT = lib.INCONSISTENT


def limits(w_on: float = 20.0, w_off: float = 15.0) -> Columns:
    """One `struct acquisition_limits`; speeds in rad/s electrical."""
    one = zeros(1, ACQUISITION_LIMITS)
    one.w_on, one.w_off = w_on, w_off
    return one


def start(n: int) -> Columns:
    """N drives of which nothing has been seen."""
    drives = zeros(n, ACQUISITION)
    for k in range(n):
        restart(drives, k)
    return drives


def restart(drives: Columns, k: int) -> None:
    """Nothing seen of drive k."""
    lib.acquisition_restart(pointer("struct acquisition", drives[k:]))


def add(samples: Columns, table: Array, drives: Columns, limits: Columns, dt: float) -> None:
    """Feed M samples; table (N, 7) as `pmsm.table`; dt: sub-step, s."""
    lib.acquisition_add(
        pointer("struct filter_sample", samples), len(samples), pointer("struct pmsm", table),
        pointer("struct acquisition", drives), pointer("struct acquisition_limits", limits), dt,
    )  # fmt: skip


def theta(drives: Columns) -> Array:
    """Angle of every drive at its last sample, rad, in (-pi, pi]."""
    first = pointer("struct acquisition", drives)
    return np.array([lib.acquisition_theta(first + k) for k in range(len(drives))])


def check(drives: Columns, filters: Columns) -> list[Consistency]:
    """Whether each drive's filter is consistent with its chords."""
    chords, each = pointer("struct acquisition", drives), pointer("struct filter", filters)
    return [Consistency(lib.acquisition_check(chords + k, each + k)) for k in range(len(drives))]


def start_filter(
    drives: Columns, k: int, table: Array, R: Array, T_rated: float, filters: Columns
) -> None:
    """X and P of filter k from the chords; R (N, 2) A^2; T_rated Nm."""
    row = np.ascontiguousarray(R[k], dtype=np.float64)
    lib.acquisition_start_filter(
        pointer("struct acquisition", drives[k:]), pointer("struct pmsm", table[k:]),
        ffi.from_buffer("double[]", row), T_rated, pointer("struct filter", filters[k:]),
    )  # fmt: skip
