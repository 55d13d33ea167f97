"""The thermal model beside the motors: what the bus says of them, second by second.

May know: estimators, readings, calibration. May not know: frames, flags. Needs of every drive the
current (`Irms` of `Status`), the speed (`Motion`) and the ambient temperature.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND
from estimators.thermal.hypotheses import HEAT, KINDS, SENSORS, side
from estimators.thermal.monitor import Known, ThermalMonitor
from estimators.thermal.trend import Trend
from gateway.health import FaultClass, FaultSensor, Flag, Reason
from gateway.warmth import AS_IT_IS, Model

Array = NDArray[np.float64]

SAMPLE_NS: Final = SECOND
"""Readings that come faster are averaged."""
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


class HeatSide:
    """The thermal monitor of N motors; `take` per temperature cycle, `work` per tick."""

    def __init__(self, known: Known, dt_s: float, limit_k: float) -> None:
        """known: of the configured motors, in their order; dt_s: between samples.

        limit_k: K that a motor may grow warmer than the others.
        """
        self.monitor = ThermalMonitor(known, dt_s)
        self.trend = Trend(len(known.parameters))
        self.limit_k = limit_k
        self.jumps = np.zeros(len(known.parameters), dtype=np.int64)

    def take(self, sample: Sample) -> None:
        """One second of all motors."""
        monitor = self.monitor
        before = monitor.offsets.copy()
        monitor.add_sample(*sample)
        self.jumps += (monitor.offsets != before).any(axis=1)
        if monitor.position:
            return
        # A block is complete. What a fault does is no degradation.
        beside = monitor.motors["off_k"] + monitor.motors["base_k"]
        seen = np.isfinite(beside)
        total = np.where(seen, beside, 0.0).sum(axis=1)
        with np.errstate(invalid="ignore"):
            deviation = np.where(monitor.held, math.nan, total / seen.sum(axis=1))
        self.trend.take(deviation, monitor.block_s / 3600.0)

    def wear(self, k: int) -> Wear:
        """What is known of motor k's degradation."""
        rate, sigma = self.trend.told(k) or (None, None)
        return Wear(rate, sigma, self.trend.time_to(k, self.limit_k), int(self.jumps[k]))

    def work(self) -> bool:
        """A motor a tick: a block of many motors must not make one tick late. False if idle."""
        if not self.monitor.waiting:
            return False
        self.monitor.judge(1)
        return True

    def say(self, out: Model) -> None:
        """What is known of every motor by now."""
        for k in range(len(self.jumps)):
            words = self._words(k)
            out.thermal[k], out.sensor[k], out.reason[k] = words[:3]
            out.fault_class[k], out.fault_sensor[k] = words[3:]
            rate = self.trend.told(k)
            out.rate_k_h[k], out.jumps[k] = math.nan if rate is None else rate[0], self.jumps[k]

    def _words(self, k: int) -> tuple[Flag, int, Reason, FaultClass, FaultSensor]:
        """Thermal and sensor evidence of motor k, reason, class, whose sensor."""
        unknown = FaultClass.UNKNOWN, FaultSensor.NONE
        if self.blind(k):
            return Flag.UNKNOWN, AS_IT_IS, Reason.STALE, *unknown
        if not self.ready(k):
            return Flag.UNKNOWN, AS_IT_IS, Reason.STARTING, *unknown
        if self.alone(k):
            return Flag.UNKNOWN, AS_IT_IS, Reason.TOO_FEW_DRIVES, *unknown
        found = self.finding(k)
        if found is None and self.undecided(k):
            # Who follows the model no longer is not good, although nobody can say yet why.
            return Flag.UNKNOWN, AS_IT_IS, Reason.DIVERGED, *unknown
        if found is None:
            return Flag.GOOD, AS_IT_IS, Reason.NONE, FaultClass.NONE, FaultSensor.NONE
        if found.fault is FaultClass.UNKNOWN:
            return Flag.UNKNOWN, Flag.UNKNOWN, Reason.DIVERGED, *unknown
        if found.sensor is FaultSensor.NONE:
            return Flag.BAD, AS_IT_IS, Reason.NONE, found.fault, found.sensor
        return Flag.UNKNOWN, Flag.BAD, Reason.NOT_AVAILABLE, found.fault, found.sensor

    def blind(self, k: int) -> bool:
        """True where its current, speed or ambient temperature has been unknown for too long."""
        return bool(self.monitor.motors[k]["unknown_s"] > BLIND_S)

    def ready(self, k: int) -> bool:
        """True once the motor has been judged by a block of readings."""
        return bool(self.monitor.motors[k]["judged"] > 0)

    def alone(self, k: int) -> bool:
        """True where no reading of its last block could be compared with other motors'."""
        return not bool(np.isfinite(self.monitor.motors[k]["off_k"]).any())

    def undecided(self, k: int) -> bool:
        """True while something is likely to be wrong with motor k, but not sure enough to say."""
        motor = self.monitor.motors[k]
        return bool(motor["fault_probability"] > LIKELY and not motor["held"])

    def finding(self, k: int) -> Finding | None:
        """What is wrong with motor k; None if nothing is likelier.

        The class is unknown while it may as well be a hot motor as a sensor that is off.
        """
        monitor = self.monitor
        if not (monitor.motors[k]["held"] or monitor.offsets[k].any()):
            return None
        kind, size = monitor.kinds()
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
