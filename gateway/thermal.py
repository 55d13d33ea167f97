"""The thermal side: temperatures in, evidence per motor and per sensor out.

Two questions are kept apart, so that a dead sensor is never a hot motor: is the sensor to
be believed (lost, stuck, stepped), and does the motor differ from the others (MAISD over the
sensors that are believed). A sensor that is not believed takes no part in the second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.frame import SECOND, Nanos
from estimators import _maisd_kernels, maisd
from gateway.calibration import POINTS, Calibration
from gateway.health import FaultClass, FaultSensor, Flag, Reason
from gateway.inbox import Temperatures

LOST_NS: Final = SECOND // 2
"""A not-available code for longer than this is a lost sensor; real ones drop for a moment."""
HOLD_MARGIN: Final = 4.0
"""A sensor is stuck when it holds a value this many times longer than ever in health."""
SHORTEST_HOLD_NS: Final = 10 * SECOND
UNCALIBRATED_HOLD_NS: Final = 240 * SECOND
"""Real sensors hold a value for up to a minute (house data); four times that, unmeasured."""
STEP_MARGIN: Final = 3.0
SMALLEST_STEP_K: Final = 2.0
STEP_READINGS: Final = 3


class Report(NamedTuple):
    """What is known of one motor: evidence for its two flags and what goes on the bus."""

    thermal: Flag = Flag.UNKNOWN
    sensor: Flag = Flag.UNKNOWN
    reason: Reason = Reason.STARTING
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor = FaultSensor.NONE
    mixed_c: float | None = None
    maisd_k: float | None = None


class _Point:
    """One sensor: its last reading and how long it has been wrong."""

    __slots__ = ("bias_k", "changed_ns", "level", "raw", "seen", "stepped", "valid_ns")

    def __init__(self) -> None:
        self.raw = -1
        self.changed_ns: Nanos = 0
        self.valid_ns: Nanos | None = None
        self.seen = False
        self.level = 0.0
        self.stepped = 0
        self.bias_k = 0.0


class ThermalSide:
    """State of all motors' temperatures; `take` per tick, `reports` when asked."""

    def __init__(
        self,
        motors: int,
        period_ns: Nanos,
        window_s: float,
        calibration: Calibration | None,
        nodes: tuple[int, ...],
    ) -> None:
        """period_ns: the temperatures' cycle; the window is `window_s` of it."""
        self.calibration = calibration
        self.period_ns = period_ns
        window = max(1, round(window_s * SECOND / period_ns))
        self.window = maisd.start(window, motors, len(POINTS))
        self.centring = calibration.centring(nodes) if calibration else None
        by_node = {m.node: m for m in calibration.motor} if calibration else {}
        self.cells = [by_node.get(n) for n in nodes]
        self.points = [[_Point() for _ in POINTS] for _ in range(motors)]
        self.values = np.zeros((motors, len(POINTS)))
        self.heard_ns: list[Nanos | None] = [None] * motors
        self.first_ns: list[Nanos] = [0] * motors
        self.next_push_ns: Nanos | None = None
        self.deviation = np.full((motors, len(POINTS)), np.nan)
        self.maisd = np.full(len(POINTS), np.nan)
        self.mean = np.zeros((motors, len(POINTS)))
        self.known = np.zeros((motors, len(POINTS)), dtype=np.bool_)
        self.largest: float | None = None
        """The largest MAISD, K."""
        self.limit_ns = 3 * period_ns
        self._cache: dict[int, tuple[Nanos, Report]] = {}

    def take(self, readings: Sequence[Temperatures], now: Nanos) -> None:
        """Accept this tick's readings; advance the windows once per temperature cycle."""
        for reading in readings:
            if self.heard_ns[reading.drive] is None:
                self.first_ns[reading.drive] = reading.t_ns
            self.heard_ns[reading.drive] = reading.t_ns
            for k in range(len(POINTS)):
                self._point(reading, k)
        if self.next_push_ns is None:
            self.next_push_ns = now if readings else None
        if self.next_push_ns is not None and now >= self.next_push_ns:
            self.next_push_ns += self.period_ns * (1 + (now - self.next_push_ns) // self.period_ns)
            self._push(now)

    def _point(self, reading: Temperatures, k: int) -> None:
        point = self.points[reading.drive][k]
        if not reading.valid[k]:
            return
        value, raw = reading.celsius[k], reading.raw[k]
        if raw != point.raw:
            point.raw, point.changed_ns = raw, reading.t_ns
        if not point.seen:
            point.level = value
        step = value - point.level - point.bias_k
        limit = self._step_limit(reading.drive, k)
        # Eight hundred kilograms do not jump: a step that stays is the sensor's, not heat's.
        point.stepped = point.stepped + 1 if abs(step) > limit else 0
        if point.stepped >= STEP_READINGS:
            point.bias_k += step
            point.stepped = 0
            if abs(point.bias_k) < limit:
                point.bias_k = 0.0
        elif not point.stepped:
            point.level += 0.2 * step
        point.seen = True
        point.valid_ns = reading.t_ns
        self.values[reading.drive, k] = value

    def _step_limit(self, drive: int, k: int) -> float:
        cell = self.cells[drive]
        return max(SMALLEST_STEP_K, STEP_MARGIN * cell.largest_step_k[k] if cell else 0.0)

    def _hold_ns(self, drive: int, k: int) -> Nanos:
        cell = self.cells[drive]
        if cell is None:
            return UNCALIBRATED_HOLD_NS
        return max(SHORTEST_HOLD_NS, round(HOLD_MARGIN * cell.longest_hold_s[k] * SECOND))

    def _push(self, now: Nanos) -> None:
        self._cache.clear()
        present = np.array(
            [
                [
                    point.seen and self._sensor(j, k, now) is FaultClass.NONE
                    for k, point in enumerate(row)
                ]
                for j, row in enumerate(self.points)
            ],
            dtype=np.bool_,
        )
        ring, seen = self.window
        _maisd_kernels.take(ring, seen, self.values, present, self.mean, self.known)
        self.window = self.window._replace(seen=seen + 1)
        self.known &= present
        centred = self.mean
        if self.centring is not None:
            gain, offset = self.centring
            centred = (self.mean - offset) / gain
        _maisd_kernels.compare(centred, self.known, self.maisd, self.deviation)
        self.largest = max((x for x in self.maisd.tolist() if math.isfinite(x)), default=None)

    def _sensor(self, drive: int, k: int, now: Nanos) -> FaultClass:
        """What is wrong with one sensor; UNKNOWN while it has never been heard."""
        point = self.points[drive][k]
        heard = self.heard_ns[drive]
        if heard is None:
            return FaultClass.UNKNOWN
        since = point.valid_ns if point.valid_ns is not None else self.first_ns[drive]
        if heard - since > LOST_NS:
            return FaultClass.SENSOR_LOST
        if point.valid_ns is None:
            return FaultClass.UNKNOWN
        if now - point.changed_ns > self._hold_ns(drive, k) and now - heard <= self.limit_ns:
            return FaultClass.SENSOR_STUCK
        return FaultClass.SENSOR_BIAS if point.bias_k else FaultClass.NONE

    def report(self, drive: int, now: Nanos, stale_ns: Nanos) -> Report:
        """Evidence for one motor at `now`; `stale_ns` is the age limit of its temperatures."""
        heard = self.heard_ns[drive]
        if heard is None:
            return Report()
        if now - heard > stale_ns:
            return Report(reason=Reason.STALE)
        cached = self._cache.get(drive)
        if cached is not None and now < cached[0]:
            return cached[1]
        found = self._look(drive, now)
        # Nothing here changes faster than the temperatures come.
        self._cache[drive] = (now + self.period_ns, found)
        return found

    def _look(self, drive: int, now: Nanos) -> Report:
        """Judge one motor anew."""
        mixed, largest = self._mixed(drive), self.largest
        for k in range(len(POINTS)):
            fault = self._sensor(drive, k, now)
            if fault not in (FaultClass.NONE, FaultClass.UNKNOWN):
                return Report(
                    sensor=Flag.BAD,
                    reason=Reason.NOT_AVAILABLE,
                    fault_class=fault,
                    fault_sensor=FaultSensor(k + 1),
                    mixed_c=mixed,
                    maisd_k=largest,
                )
        booting = any(point.valid_ns is None for point in self.points[drive])
        seen = Flag.UNKNOWN if booting else Flag.GOOD
        good = Report(sensor=seen, mixed_c=mixed, maisd_k=largest)
        if self.calibration is None:
            return good._replace(reason=Reason.CONFIG)
        if not self.known[drive].all():
            return good._replace(reason=Reason.STARTING)
        if not np.isfinite(self.deviation[drive]).all():
            return good._replace(reason=Reason.TOO_FEW_DRIVES)
        return self._judge(drive, good)

    def _judge(self, drive: int, good: Report) -> Report:
        """MAISD says that the fleet differs; the deviation says which motor it is."""
        assert self.calibration is not None
        limit = np.array(self.calibration.maisd_limit_k)
        beyond = self.deviation[drive] > np.array(self.calibration.deviation_limit_k)
        hot = beyond & (self.maisd > limit)
        if not hot.any():
            return good._replace(thermal=Flag.GOOD, reason=Reason.NONE, fault_class=FaultClass.NONE)
        stator, drive_end, non_drive_end = hot
        if stator and (drive_end or non_drive_end):
            kind = FaultClass.COOLING_LOSS
        elif stator:
            kind = FaultClass.OVERHEATING
        else:
            kind = FaultClass.BEARING
        return good._replace(thermal=Flag.BAD, reason=Reason.NONE, fault_class=kind)

    def _mixed(self, drive: int) -> float | None:
        """Mean of the believed window averages, degC."""
        rows = zip(self.mean[drive].tolist(), self.known[drive].tolist(), strict=True)
        believed = [mean for mean, known in rows if known]
        return sum(believed) / len(believed) if believed else None
