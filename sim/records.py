"""NumPy types of the simulator's compiled part, made from `sim/records.h` by the compiler's layout.

May know: where records lie. May not know: what they are for.
"""

from __future__ import annotations

from typing import Final

from _traction_core import ffi, lib

from dbc.records import Columns, dtype_of, pointer, zeros

__all__ = ["DRIVE", "MOTOR", "RAIL", "TRAIN", "Columns", "ffi", "lib", "pointer", "zeros"]

MOTOR: Final = dtype_of(ffi.typeof("struct sim_motor"))
DRIVE: Final = dtype_of(ffi.typeof("struct sim_drive"))
TRAIN: Final = dtype_of(ffi.typeof("struct sim_train"))
RAIL: Final = dtype_of(ffi.typeof("struct sim_rail"))
