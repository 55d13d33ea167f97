"""Is a temperature sensor to be believed: lost, stuck, stepped; alone or with all of its drive.

May know: readings and what the calibration says of each sensor. May not know: what the motors'
temperatures mean. A point that is not configured takes part in nothing and is never lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from gateway import warmth
from gateway._sensors_kernels import (
    believe,
    booting,
    fault,
    note_reading,
    take_point,
    verdict,
)
from gateway.calibration import POINTS, MotorCalibration
from gateway.health import FaultClass, FaultSensor
from gateway.inbox import Temperatures

HOLD_MARGIN: Final = 4.0
"""A sensor is stuck when it holds a value this many times longer than ever in health."""
SHORTEST_HOLD_NS: Final = 10 * SECOND
LONGEST_HOLD_NS: Final = 1 << 62
"""What there is room for."""
UNCALIBRATED_HOLD_NS: Final = 240 * SECOND
"""Real sensors hold a value for up to a minute (house data); four times that, unmeasured."""
QUIET_K: Final = 0.25
"""A sensor that never moved by more than two steps of the wire has no noise to tell a dead one by.

Between two steps it holds for as long as the motor keeps its temperature: real ones, seconds in
one minute and two minutes in the next. What it held in health is no limit then.
"""
STEP_MARGIN: Final = 3.0
SMALLEST_STEP_K: Final = 2.0


class SensorSide:
    """State of all drives' sensors; `take` per reading, `fault` and `verdict` when asked."""

    def __init__(
        self,
        drives: int,
        period_ns: Nanos,
        cells: Sequence[MotorCalibration | None] | None = None,
        sensors: Sequence[Sequence[str]] | None = None,
    ) -> None:
        """period_ns: the readings' cycle; cells, sensors: per drive, None: nothing learnt, all.

        sensors: names of `POINTS`.
        """
        self.cells = [None] * drives if cells is None else list(cells)
        fitted = [POINTS] * drives if sensors is None else sensors
        self.configured: NDArray[np.bool_] = np.array(
            [[name in names for name in POINTS] for names in fitted], dtype=np.bool_
        )
        """(N, P): which drive has which sensor."""
        each = [[(j, k) for k in range(len(POINTS))] for j in range(drives)]
        self.points = warmth.points(
            self.configured,
            np.array([[self.step_limit(j, k) for j, k in row] for row in each]),
            np.array([[self.hold_ns(j, k) for j, k in row] for row in each], dtype=np.int64),
            period_ns,
        )

    def take(self, reading: Temperatures) -> None:
        """Accept one reading of one drive."""
        drive = reading.drive
        note_reading(drive, reading.t_ns, self.points)
        for k in np.flatnonzero(self.configured[drive] & reading.valid[: len(POINTS)]).tolist():
            celsius = float(reading.celsius[k])
            take_point(drive, k, reading.t_ns, celsius, reading.raw[k], self.points)

    def step_limit(self, drive: int, k: int) -> float:
        """A change beyond this, K, that stays for `STEP_READINGS` is an offset."""
        cell = self.cells[drive]
        return max(SMALLEST_STEP_K, STEP_MARGIN * cell.largest_step_k[k] if cell else 0.0)

    def hold_ns(self, drive: int, k: int) -> Nanos:
        """A value held for longer than this is a stuck sensor's."""
        cell = self.cells[drive]
        if cell is None:
            return UNCALIBRATED_HOLD_NS
        quiet = cell.largest_step_k[k] <= QUIET_K
        least = UNCALIBRATED_HOLD_NS if quiet else SHORTEST_HOLD_NS
        return min(
            max(least, round(HOLD_MARGIN * cell.longest_hold_s[k] * SECOND)), LONGEST_HOLD_NS
        )

    def fault(self, drive: int, k: int, now: Nanos) -> FaultClass:
        """What is wrong with one sensor; UNKNOWN while it has never been heard.

        NONE for a point that is not configured.
        """
        return FaultClass(fault(drive, k, now, self.points))

    def believed(self, now: Nanos) -> NDArray[np.bool_]:
        """(N, P): configured, heard and without fault."""
        out = np.zeros_like(self.configured)
        believe(now, self.points, out)
        return out

    def booting(self, drive: int) -> bool:
        """True while a configured sensor has never given a valid value."""
        return bool(booting(drive, self.points))

    def verdict(self, drive: int, now: Nanos) -> tuple[FaultClass, FaultSensor]:
        """The drive's first sensor fault and whose it is; (NONE, NONE) if there is none.

        Where all sensors of a drive, at least two, are offset or lost since the same moment
        (`TOGETHER`), whichever way they went, no sensor is named (FaultSensor.NONE): what they
        share has failed, the converter or the supply of their acquisition channel.
        """
        kind, whose = verdict(drive, now, self.points)
        return FaultClass(kind), FaultSensor(whose)
