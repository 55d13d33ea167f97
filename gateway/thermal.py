"""The thermal side: temperatures in, evidence per motor and per sensor out.

Two questions are kept apart, so that a dead sensor is never a hot motor: is the sensor to
be believed (`gateway/sensors.py`), and what is wrong with the motor: by its thermal model
(`gateway/heatside.py`), or, with `method = "maisd"`, by how it differs from the others. A sensor
that is not believed takes no part in the second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.frame import SECOND, Nanos
from estimators import _maisd_kernels, maisd
from gateway.calibration import POINTS, Calibration
from gateway.config import ConfigError
from gateway.health import NEVER, FaultClass, FaultSensor, Flag, Reason
from gateway.heatside import HeatSide, Sample, Seconds, Wear
from gateway.inbox import DriveInput, Temperatures
from gateway.said import Findings
from gateway.sensors import SensorSide

FOREVER: Final[Nanos] = (1 << 63) - 1
NO_MODEL: Final = (
    "no thermal model of every configured motor: calibrate with logs that have Status and Motion "
    'and a changing duty, or set [thermal] method = "maisd"'
)


class Report(NamedTuple):
    """What is known of one motor: evidence for its two flags and what goes on the bus."""

    thermal: Flag = Flag.UNKNOWN
    sensor: Flag = Flag.UNKNOWN
    reason: Reason = Reason.STARTING
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor = FaultSensor.NONE
    mixed_c: float | None = None
    maisd_k: float | None = None
    wear: Wear = Wear()


class ThermalSide:
    """State of all motors' temperatures; `take` per tick, `reports` when asked."""

    def __init__(
        self,
        motors: int,
        period_ns: Nanos,
        window_s: float,
        calibration: Calibration | None,
        nodes: tuple[int, ...],
        sensors: Sequence[Sequence[str]] | None = None,
        *,
        model: bool = False,
        limit_k: float = 10.0,
    ) -> None:
        """period_ns: the temperatures' cycle; the window is `window_s` of it.

        sensors: names of the points each drive has; None: all have all. model: judge by the thermal
        model; limit_k: K that a motor may grow warmer than the others. Raises ConfigError where
        the calibration has no model.
        """
        self.calibration = calibration
        self.period_ns = period_ns
        window = max(1, round(window_s * SECOND / period_ns))
        self.window = maisd.start(window, motors, len(POINTS))
        self.centring = calibration.centring(nodes) if calibration else None
        by_node = {m.node: m for m in calibration.motor} if calibration else {}
        cells = [by_node.get(n) for n in nodes]
        self.sensors = SensorSide(motors, period_ns, cells, sensors)
        self.points = self.sensors.points
        self.values = self.sensors.values
        self.heard_ns = self.sensors.heard_ns
        self.next_push_ns: Nanos | None = None
        self.deviation = np.full((motors, len(POINTS)), np.nan)
        self.maisd = np.full(len(POINTS), np.nan)
        self.mean = np.zeros((motors, len(POINTS)))
        self.known = np.zeros((motors, len(POINTS)), dtype=np.bool_)
        self.largest: float | None = None
        """The largest MAISD, K."""
        self.seconds = Seconds(motors, period_ns)
        self.last: Sample | None = None
        """The newest second, in the temperature cycle that completed it."""
        self.learning = False
        """Look at seconds although there is no model: one is to be learnt."""
        self.heat: HeatSide | None = None
        if model and calibration is not None:
            known = calibration.known(nodes)
            if known is None:
                raise ConfigError("calibration", [NO_MODEL])
            self.heat = HeatSide(known, self.seconds.dt_s, limit_k)
        self._cache: dict[int, tuple[Nanos, Report]] = {}
        self._stirred = True
        """Something came since reports were last told."""
        self._until_ns: Nanos = 0
        """When the first of them is to be asked for again, though nothing comes."""
        self.reports = [Report() for _ in range(motors)]
        """As last told."""

    def take(
        self, readings: Sequence[Temperatures], now: Nanos, drives: Sequence[DriveInput] = ()
    ) -> None:
        """Accept this tick's readings; advance the windows once per temperature cycle.

        drives: what else they have said, for the thermal model.
        """
        for reading in readings:
            self.sensors.take(reading)
            self.seconds.note(reading)
        self._stirred |= bool(readings)
        if self.next_push_ns is None:
            self.next_push_ns = now if readings else None
        if self.next_push_ns is not None and now >= self.next_push_ns:
            self.next_push_ns += self.period_ns * (1 + (now - self.next_push_ns) // self.period_ns)
            self._push(now, drives)
        if self.heat is not None:
            self.heat.work()

    def _push(self, now: Nanos, drives: Sequence[DriveInput]) -> None:
        self._cache.clear()
        self._stirred = True
        present = self.sensors.believed(now)
        if self.heat is not None or self.learning:
            self.last = self.seconds.look(self.values, present, drives, now)
            if self.last is not None and self.heat is not None:
                self.heat.take(self.last)
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

    def tell(self, now: Nanos, stale_ns: Sequence[Nanos], out: Findings) -> None:
        """Every motor's report into `out`, where one can have changed since the last call."""
        if not self._stirred and now < self._until_ns:
            return
        self._stirred, self._until_ns = False, FOREVER
        for k, limit in enumerate(stale_ns):
            self.reports[k] = report = self.report(k, now, limit)
            heard = self.heard_ns[k]
            if heard is not None and now - heard <= limit:
                self._until_ns = min(self._until_ns, self._cache[k][0], heard + limit + 1)
            out.heard_ns[k] = NEVER if heard is None else heard
            out.thermal[k], out.sensor[k], out.reason[k] = report[:3]
            out.fault_class[k], out.fault_sensor[k] = report.fault_class, report.fault_sensor
            out.mixed_c[k] = math.nan if report.mixed_c is None else report.mixed_c
            out.maisd_k[k] = math.nan if report.maisd_k is None else report.maisd_k
            rate = report.wear.rate_k_h
            out.rate_k_h[k], out.jumps[k] = math.nan if rate is None else rate, report.wear.jumps

    @property
    def same_ns(self) -> Nanos:
        """Nothing is told anew before it, if no reading comes."""
        if self._stirred or self.heat is not None:
            return NEVER
        push = FOREVER if self.next_push_ns is None else self.next_push_ns
        return min(push, self._until_ns)

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
        wear = self.heat.wear(drive) if self.heat is not None else Wear()
        fault, sensor = self.sensors.verdict(drive, now)
        if fault is not FaultClass.NONE:
            return Report(
                sensor=Flag.BAD,
                reason=Reason.NOT_AVAILABLE,
                fault_class=fault,
                fault_sensor=sensor,
                mixed_c=mixed,
                maisd_k=largest,
                wear=wear,
            )
        seen = Flag.UNKNOWN if self.sensors.booting(drive) else Flag.GOOD
        good = Report(sensor=seen, mixed_c=mixed, maisd_k=largest, wear=wear)
        if self.calibration is None:
            return good._replace(reason=Reason.CONFIG)
        if self.heat is not None:
            return self._modelled(drive, self.heat, good)
        fitted = self.sensors.configured[drive]
        if not self.known[drive][fitted].all():
            return good._replace(reason=Reason.STARTING)
        if not np.isfinite(self.deviation[drive][fitted]).all():
            return good._replace(reason=Reason.TOO_FEW_DRIVES)
        return self._judge(drive, good)

    def _modelled(self, drive: int, side: HeatSide, good: Report) -> Report:
        """What the thermal model of the motor says."""
        if side.blind(drive):
            return good._replace(reason=Reason.STALE)
        if not side.ready(drive):
            return good._replace(reason=Reason.STARTING)
        if side.alone(drive):
            return good._replace(reason=Reason.TOO_FEW_DRIVES)
        found = side.finding(drive)
        if found is None and side.undecided(drive):
            # Who follows the model no longer is not good, although nobody can say yet why.
            return good._replace(reason=Reason.DIVERGED)
        if found is None:
            return good._replace(thermal=Flag.GOOD, reason=Reason.NONE, fault_class=FaultClass.NONE)
        if found.fault is FaultClass.UNKNOWN:
            return good._replace(sensor=Flag.UNKNOWN, reason=Reason.DIVERGED)
        named = good._replace(fault_class=found.fault, fault_sensor=found.sensor)
        if found.sensor is FaultSensor.NONE:
            return named._replace(thermal=Flag.BAD, reason=Reason.NONE)
        return named._replace(sensor=Flag.BAD, reason=Reason.NOT_AVAILABLE)

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
