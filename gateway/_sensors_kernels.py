"""Temperature sensors of the compiled core (`gateway/core/temperature.c`) for numba's loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined
from dbc.records import TEMPERATURE_DRIVE, Records

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_DRIVE = TEMPERATURE_DRIVE.itemsize
_add_reading, _add_value = symbol("temperature_add_reading"), symbol("temperature_add_value")
_fault, _fault_sensor = symbol("temperature_fault"), symbol("temperature_fault_sensor")
_not_yet_valid, _values = symbol("temperature_not_yet_valid"), symbol("temperature_values")
_received_ns = symbol("temperature_received_ns")


@inlined
def add_reading(j: int, t: int, drives: Records) -> None:
    """`temperature_add_reading` of drive j."""
    _add_reading(drives.ctypes.data + int(j) * _DRIVE, t)


@inlined
def add_value(j: int, k: int, t: int, value: float, raw: int, drives: Records) -> None:
    """`temperature_add_value` of drive j's sensor k."""
    _add_value(drives.ctypes.data + int(j) * _DRIVE, k, t, value, raw)


@inlined
def sensor_values(now: int, drives: Records, values: Array, valid: Bools) -> None:
    """`temperature_values`: fills values and valid (N, P)."""
    _values(drives.ctypes.data, drives.shape[0], now, values.ctypes.data, valid.ctypes.data)


@inlined
def not_yet_valid(j: int, drives: Records) -> bool:
    """`temperature_not_yet_valid` of drive j."""
    return _not_yet_valid(drives.ctypes.data + int(j) * _DRIVE) != 0  # type: ignore[no-any-return]


@inlined
def fault(j: int, now: int, drives: Records) -> int:
    """`temperature_fault` of drive j."""
    return _fault(drives.ctypes.data + int(j) * _DRIVE, now)  # type: ignore[no-any-return]


@inlined
def fault_sensor(j: int, now: int, drives: Records) -> int:
    """`temperature_fault_sensor` of drive j."""
    return _fault_sensor(drives.ctypes.data + int(j) * _DRIVE, now)  # type: ignore[no-any-return]


@inlined
def received_ns(j: int, drives: Records) -> int:
    """`temperature_received_ns` of drive j."""
    return _received_ns(drives.ctypes.data + int(j) * _DRIVE)  # type: ignore[no-any-return]
