"""Validity of temperature sensors: lost, stuck or biased, alone or all of a drive.

The rules are in `gateway/core/temperature.c`; this module has each sensor's limits.

May know: readings and the calibration of each sensor. May not know: what the motors'
temperatures mean. A point that is not configured takes part in nothing and is never lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from dbc.records import TEMPERATURE_DRIVE, pointer
from gateway.settings.calibration import POINTS, MotorCalibration

HOLD_MARGIN: Final = 4.0
"""A sensor is stuck when it holds a value this many times longer than ever in health."""
SHORTEST_HOLD_NS: Final = 10 * SECOND
LONGEST_HOLD_NS: Final = 1 << 62
"""Longest time that fits."""
UNCALIBRATED_HOLD_NS: Final = 240 * SECOND
"""Real sensors hold a value for up to a minute (house data); four times that if uncalibrated."""
QUIET_K: Final = 0.25
"""A sensor that never moved by more than two steps of its resolution has too little noise to show
that it is alive.

Between two steps it holds its value for as long as the motor keeps its temperature: real sensors,
for seconds in one minute and for two minutes in the next. Its longest hold in health alone is then
no limit.
"""
STEP_MARGIN: Final = 3.0
SMALLEST_STEP_K: Final = 2.0


class SensorMonitor:
    """State of all drives' sensors."""

    def __init__(
        self,
        drives: int,
        period_ns: Nanos,
        cells: Sequence[MotorCalibration | None] | None = None,
        sensors: Sequence[Sequence[str]] | None = None,
    ) -> None:
        """period_ns: the readings' cycle; cells: per drive, None: nothing learnt.

        sensors: per drive the names of its sensors in `POINTS`, None: all.
        """
        self.cells = [None] * drives if cells is None else list(cells)
        fitted = [POINTS] * drives if sensors is None else sensors
        self.configured: NDArray[np.bool_] = np.array(
            [[name in names for name in POINTS] for names in fitted], dtype=np.bool_
        )
        """(N, P): which drive has which sensor."""
        self.drives = np.zeros(drives, TEMPERATURE_DRIVE)
        """(N,) of `struct temperature_drive`."""
        self.drives["period_ns"] = period_ns
        sensor = self.drives["sensor"]
        sensor["configured"] = self.configured
        for j, k in np.ndindex(*sensor.shape):
            sensor[j, k]["limit_k"] = self.step_limit(j, k)
            sensor[j, k]["stuck_after_ns"] = self.stuck_after_ns(j, k)
        for drive in pointer("struct temperature_drive", self.drives):
            lib.temperature_reset(ffi.addressof(drive))

    def step_limit(self, drive: int, k: int) -> float:
        """A lasting change by more than this, K, is an offset."""
        cell = self.cells[drive]
        return max(SMALLEST_STEP_K, STEP_MARGIN * cell.largest_step_k[k] if cell else 0.0)

    def stuck_after_ns(self, drive: int, k: int) -> Nanos:
        """A sensor that holds a value for longer than this is stuck."""
        cell = self.cells[drive]
        if cell is None:
            return UNCALIBRATED_HOLD_NS
        quiet = cell.largest_step_k[k] <= QUIET_K
        least = UNCALIBRATED_HOLD_NS if quiet else SHORTEST_HOLD_NS
        return min(
            max(least, round(HOLD_MARGIN * cell.longest_hold_s[k] * SECOND)), LONGEST_HOLD_NS
        )
