"""Calibration of current sensors: `current_calibration.c` for records of N drives."""

from __future__ import annotations

from _traction_core import ffi, lib

from dbc.arrays import Array
from dbc.records import CURRENT_CALIBRATION, Columns, pointer, zeros


def start(n: int) -> Columns:
    """Nothing learnt: the sensors are what they should be."""
    return zeros(n, CURRENT_CALIBRATION)


def restart(drives: Columns, k: int) -> None:
    """Nothing learnt of drive k."""
    drives[k] = zeros(1, CURRENT_CALIBRATION)[0]


def calibrate(
    samples: Columns, drives: Columns, chords: Columns, I_rated: Array, dt: float
) -> None:
    """Correct the currents of M samples, in place, and learn; I_rated (N,) A; dt: sub-step, s."""
    lib.calibrate_currents(
        pointer("struct filter_sample", samples), len(samples),
        pointer("struct current_calibration", drives), pointer("struct acquisition", chords),
        ffi.from_buffer("double[]", I_rated), dt,
    )  # fmt: skip


def is_single_axis(drives: Columns, k: int, w_e: float) -> bool:
    """True while the current of drive k swings on one line; w_e: electrical speed, rad/s."""
    one = pointer("struct current_calibration", drives[k:])
    return bool(lib.is_single_axis_current(one, w_e))
