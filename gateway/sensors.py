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
from gateway.calibration import POINTS, MotorCalibration
from gateway.health import FaultClass, FaultSensor
from gateway.inbox import Temperatures

LOST_NS: Final = SECOND // 2
"""A not-available code for longer than this is a lost sensor; real ones drop for a moment."""
HOLD_MARGIN: Final = 4.0
"""A sensor is stuck when it holds a value this many times longer than ever in health."""
SHORTEST_HOLD_NS: Final = 10 * SECOND
UNCALIBRATED_HOLD_NS: Final = 240 * SECOND
"""Real sensors hold a value for up to a minute (house data); four times that, unmeasured."""
QUIET_K: Final = 0.25
"""A sensor that never moved by more than two steps of the wire has no noise to tell a dead one by.

Between two steps it holds for as long as the motor keeps its temperature: real ones, seconds in
one minute and two minutes in the next. What it held in health is no limit then.
"""
STEP_MARGIN: Final = 3.0
SMALLEST_STEP_K: Final = 2.0
STEP_READINGS: Final = 3
SUDDEN: Final = 0.4
"""Share of a step that has to come from one reading to the next. What comes in smaller portions is
heat's: a small motor's winding may warm by kelvins within a second."""
FULL_C: Final = 300.0
"""The most that a reading can say: a motor that has warmed up to it is as hot or hotter."""
FULL_STEPS: Final = 5.0
"""A sensor that was further below it, in limits of a step, has jumped there."""
FORGET_NS: Final = 10 * SECOND
"""After longer without a valid value the motor may have changed by more than a step's limit."""
TOGETHER: Final = 2
"""Faults of all sensors within this many readings of one another have a common source."""
ALARMING: Final = (FaultClass.SENSOR_BIAS, FaultClass.SENSOR_STUCK, FaultClass.SENSOR_LOST)


class Point:
    """One sensor: its last reading and how long it has been wrong."""

    __slots__ = (
        "bias_k",
        "changed_ns",
        "full",
        "jump",
        "jumped_at",
        "level",
        "raw",
        "seen",
        "slope",
        "stepped",
        "valid_at",
        "valid_ns",
        "value",
    )

    def __init__(self) -> None:
        self.raw = -1
        self.changed_ns: Nanos = 0
        self.valid_ns: Nanos | None = None
        self.seen = False
        self.value = 0.0
        self.level = 0.0
        self.stepped = 0
        self.jump = 0.0
        """Largest change from one of these readings to the next, beside the slope until then."""
        self.slope = 0.0
        """K per reading, of the latest ones."""
        self.full = False
        """It has warmed up to `FULL_C`: that it stops there is the wire's doing."""
        self.bias_k = 0.0
        self.valid_at = 0
        """Which of the drive's readings was its last valid one, from 1; 0 if none."""
        self.jumped_at = 0
        """Which of the drive's readings gave it the offset that it has."""


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
        self.fitted = [np.flatnonzero(row).tolist() for row in self.configured]
        self.points = [[Point() for _ in POINTS] for _ in range(drives)]
        self.values = np.zeros((drives, len(POINTS)))
        self.heard_ns: list[Nanos | None] = [None] * drives
        self.first_ns: list[Nanos] = [0] * drives
        self.readings = [0] * drives
        self.period_ns = period_ns
        self.limit_ns = 3 * period_ns

    def take(self, reading: Temperatures) -> None:
        """Accept one reading of one drive."""
        drive = reading.drive
        if self.heard_ns[drive] is None:
            self.first_ns[drive] = reading.t_ns
        self.heard_ns[drive] = reading.t_ns
        self.readings[drive] += 1
        for k in self.fitted[drive]:
            if reading.valid[k]:
                self._point(reading, k)

    def _point(self, reading: Temperatures, k: int) -> None:
        drive = reading.drive
        point = self.points[drive][k]
        value, raw = reading.celsius[k], reading.raw[k]
        back = point.valid_ns is None or reading.t_ns - point.valid_ns > FORGET_NS
        if raw != point.raw or back:
            point.raw, point.changed_ns = raw, reading.t_ns
        # An offset once found stays: silence does not clear it.
        if back and not point.bias_k:
            point.level = value
        step = value - point.level - point.bias_k
        limit = self.step_limit(drive, k)
        point.full = value >= FULL_C and not back and abs(step) < FULL_STEPS * limit
        change, passed = 0.0, 1
        if not back and point.valid_ns is not None:
            change = value - point.value
            passed = max(round((reading.t_ns - point.valid_ns) / self.period_ns), 1)
        beside = change - point.slope * passed
        if abs(step) > limit and not point.full:
            point.stepped += 1
            point.jump = max(point.jump, min(abs(change), abs(beside)))
        else:
            point.stepped, point.jump = 0, 0.0
            point.level += 0.2 * step
        if point.stepped >= STEP_READINGS:
            # No motor jumps: what stays after a sudden step is the sensor's, not heat's.
            if point.jump > SUDDEN * abs(step):
                point.bias_k += step
                point.jumped_at = self.readings[drive]
                if abs(point.bias_k) < limit:
                    point.bias_k = 0.0
            else:
                point.level += step
            point.stepped, point.jump = 0, 0.0
        point.value = value
        point.slope += 0.2 * (change / passed - point.slope)
        point.seen = True
        point.valid_ns = reading.t_ns
        point.valid_at = self.readings[drive]
        self.values[drive, k] = value

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
        return max(least, round(HOLD_MARGIN * cell.longest_hold_s[k] * SECOND))

    def fault(self, drive: int, k: int, now: Nanos) -> FaultClass:
        """What is wrong with one sensor; UNKNOWN while it has never been heard.

        NONE for a point that is not configured.
        """
        if not self.configured[drive, k]:
            return FaultClass.NONE
        point = self.points[drive][k]
        heard = self.heard_ns[drive]
        if heard is None:
            return FaultClass.UNKNOWN
        since = point.valid_ns if point.valid_ns is not None else self.first_ns[drive]
        if heard - since > LOST_NS:
            return FaultClass.SENSOR_LOST
        if point.valid_ns is None:
            return FaultClass.UNKNOWN
        held = now - point.changed_ns > self.hold_ns(drive, k) and not point.full
        if held and now - heard <= self.limit_ns:
            return FaultClass.SENSOR_STUCK
        return FaultClass.SENSOR_BIAS if point.bias_k else FaultClass.NONE

    def believed(self, now: Nanos) -> NDArray[np.bool_]:
        """(N, P): configured, heard and without fault."""
        drives, points = self.configured.shape
        return np.array(
            [
                [
                    self.points[j][k].seen and self.fault(j, k, now) is FaultClass.NONE
                    for k in range(points)
                ]
                for j in range(drives)
            ],
            dtype=np.bool_,
        )

    def booting(self, drive: int) -> bool:
        """True while a configured sensor has never given a valid value."""
        return any(self.points[drive][k].valid_ns is None for k in self.fitted[drive])

    def verdict(self, drive: int, now: Nanos) -> tuple[FaultClass, FaultSensor]:
        """The drive's first sensor fault and whose it is; (NONE, NONE) if there is none.

        Where all sensors of a drive, at least two, are offset or lost since the same moment
        (`TOGETHER`), whichever way they went, no sensor is named (FaultSensor.NONE): what they
        share has failed, the converter or the supply of their acquisition channel.
        """
        fitted = self.fitted[drive]
        found = [self.fault(drive, k, now) for k in fitted]
        if len(found) > 1 and len(set(found)) == 1:
            points = [self.points[drive][k] for k in fitted]
            if found[0] is FaultClass.SENSOR_BIAS and _together([p.jumped_at for p in points]):
                return FaultClass.SENSOR_BIAS, FaultSensor.NONE
            if found[0] is FaultClass.SENSOR_LOST and _together([p.valid_at for p in points]):
                return FaultClass.SENSOR_LOST, FaultSensor.NONE
        for k, fault in zip(fitted, found, strict=True):
            if fault in ALARMING:
                return fault, FaultSensor(k + 1)
        return FaultClass.NONE, FaultSensor.NONE


def _together(readings: Sequence[int]) -> bool:
    return max(readings) - min(readings) <= TOGETHER
