"""The thermal model beside the motors: what the bus says of them, second by second, to `watch`.

May know: estimators, readings, calibration. May not know: frames, flags. Needs of every drive the
current (`Irms` of `Status`), the speed (`Motion`) and the ambient temperature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from estimators.thermal.hypotheses import HEAT, KINDS, SENSORS, side
from estimators.thermal.trend import Trend
from estimators.thermal.watch import Known, Watch
from gateway.health import FaultClass, FaultSensor
from gateway.inbox import DriveInput, Temperatures

Array = NDArray[np.float64]

SAMPLE_NS: Final = SECOND
"""Readings that come faster are averaged."""
POINTS: Final = 3
AMBIENT: Final = 3
LIKELY: Final = 0.5
"""Probability of a fault from which a motor is not called good."""
BLIND_S: Final = 5.0
"""So long without current, speed or ambient: nothing is known of the heat any more."""
CLASSES: Final = {
    "overheating": FaultClass.OVERHEATING,
    "cooling_loss": FaultClass.COOLING_LOSS,
    "bearing_de": FaultClass.BEARING,
    "bearing_nde": FaultClass.BEARING,
    "winding_resistance": FaultClass.WINDING_RESISTANCE,
}
"""Of kinds of heat; all others are a sensor's: a loose connector is one that is off at times."""


class Sample(NamedTuple):
    """Means of a second: temperature (M, 3) degC, square (M,) A^2, speed, ambient; NaN: unknown."""

    temperature: Array
    square: Array
    speed: Array
    ambient: Array


class Finding(NamedTuple):
    """What is wrong with one motor: its class, and whose sensor if it is one."""

    fault: FaultClass
    sensor: FaultSensor
    size_k: float


class Wear(NamedTuple):
    """How a motor grows warmer than the others.

    rate_k_h, sigma_k_h: None before enough was seen; hours: until it is at its limit, None if it
    need not come; jumps: steps of its sensors.
    """

    rate_k_h: float | None = None
    sigma_k_h: float | None = None
    hours: float | None = None
    jumps: int = 0


class Seconds:
    """Averages of what the bus says, one sample a second."""

    def __init__(self, motors: int, period_ns: Nanos) -> None:
        """period_ns: the temperatures' cycle, at which currents and speeds are looked at, too."""
        self.every = max(round(SAMPLE_NS / period_ns), 1)
        self.dt_s = self.every * period_ns / SECOND
        self._sums = np.zeros((motors, POINTS + 3))
        self._counts = np.zeros((motors, POINTS + 3))
        self._ambient = np.full(motors, math.nan)
        self._at = 0

    def note(self, reading: Temperatures) -> None:
        """The ambient temperature is a drive's own; the points come with `look`."""
        valid = reading.valid[AMBIENT]
        self._ambient[reading.drive] = reading.celsius[AMBIENT] if valid else math.nan

    def look(
        self, values: Array, believed: NDArray[np.bool_], drives: Sequence[DriveInput], now: Nanos
    ) -> Sample | None:
        """One temperature cycle; a sample when a second is full.

        values (M, 3) degC of sensors that are `believed` (M, 3).
        """
        for k, drive in enumerate(drives):
            row, count = self._sums[k], self._counts[k]
            row[:POINTS] += np.where(believed[k], values[k], 0.0)
            count[:POINTS] += believed[k]
            status, motion = drive.status, drive.motion
            known = (
                drive.irms is not None and status is not None and status.fresh(now),
                drive.speed is not None and motion is not None and motion.fresh(now),
                bool(believed[k].any()) and math.isfinite(self._ambient[k]),
            )
            seen = (2.0 * (drive.irms or 0.0) ** 2, abs(drive.speed or 0.0), self._ambient[k])
            for i, (there, value) in enumerate(zip(known, seen, strict=True), POINTS):
                if there:
                    row[i] += value
                    count[i] += 1.0
        self._at += 1
        if self._at < self.every:
            return None
        with np.errstate(invalid="ignore"):
            mean = self._sums / self._counts
        self._at = 0
        self._sums[:], self._counts[:] = 0.0, 0.0
        return Sample(mean[:, :POINTS], mean[:, POINTS], mean[:, POINTS + 1], mean[:, POINTS + 2])


class HeatSide:
    """The watch of N motors; `take` per temperature cycle, `work` per tick."""

    def __init__(self, known: Known, dt_s: float, limit_k: float) -> None:
        """known: of the configured motors, in their order; dt_s: between samples.

        limit_k: K that a motor may grow warmer than the others.
        """
        self.watch = Watch(known, dt_s)
        self.trend = Trend(len(known.parameters))
        self.limit_k = limit_k
        self.jumps = np.zeros(len(known.parameters), dtype=np.int64)

    def take(self, sample: Sample) -> None:
        """One second of all motors."""
        watch = self.watch
        before = watch.offsets.copy()
        watch.take(*sample)
        self.jumps += (watch.offsets != before).any(axis=1)
        if watch.at:
            return
        # A block is complete. What a fault does is no degradation.
        beside = watch.off + watch.base
        seen = np.isfinite(beside)
        total = np.where(seen, beside, 0.0).sum(axis=1)
        with np.errstate(invalid="ignore"):
            deviation = np.where(watch.held, math.nan, total / seen.sum(axis=1))
        self.trend.take(deviation, watch.block_s / 3600.0)

    def wear(self, k: int) -> Wear:
        """What is known of motor k's degradation."""
        rate, sigma = self.trend.told(k) or (None, None)
        return Wear(rate, sigma, self.trend.time_to(k, self.limit_k), int(self.jumps[k]))

    def work(self) -> None:
        """A motor a tick: a block of many motors must not make one tick late."""
        if self.watch.waiting:
            self.watch.work(1)

    def blind(self, k: int) -> bool:
        """True where its current, speed or ambient temperature has been unknown for too long."""
        return bool(self.watch.unknown_s[k] > BLIND_S)

    def ready(self, k: int) -> bool:
        """True once the motor has been judged by a block of readings."""
        return bool(self.watch.judged[k] > 0)

    def alone(self, k: int) -> bool:
        """True where no reading of its last block could be compared with other motors'."""
        return not bool(np.isfinite(self.watch.off[k]).any())

    def undecided(self, k: int) -> bool:
        """True while something is likely to be wrong with motor k, but not sure enough to say."""
        return bool(self.watch.ill[k] > LIKELY and not self.watch.held[k])

    def finding(self, k: int) -> Finding | None:
        """What is wrong with motor k; None if nothing is likelier.

        The class is unknown while it may as well be a hot motor as a sensor that is off.
        """
        watch = self.watch
        stepped = watch.offsets[k].any()
        if not (watch.held[k] or stepped):
            return None
        kind, size = watch.told()
        whose = int(side(kind[k]))
        if not whose:
            return Finding(FaultClass.UNKNOWN, FaultSensor.NONE, float(size[k]))
        first = 0 if whose > 0 else len(HEAT)
        last = len(HEAT) if whose > 0 else len(KINDS)
        name = KINDS[first + int(kind[k, first:last].argmax())]
        if name in CLASSES:
            return Finding(CLASSES[name], FaultSensor.NONE, float(size[k]))
        point = (KINDS.index(name) - len(HEAT)) % len(SENSORS)
        return Finding(FaultClass.SENSOR_BIAS, FaultSensor(point + 1), float(size[k]))
