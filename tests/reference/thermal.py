"""Temperatures of motors in plain Python, which `gateway/core/thermal.c` is compared with.

Validity of sensors, windows, MAISD and the thermal monitor have references of their own; here the
product's are used.
"""

from __future__ import annotations

import math

import numpy as np

from estimators import maisd
from estimators.thermal.hypotheses import HEAT, KINDS, side
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from tests.stations import not_yet_valid, sensor_verdict, sensors_valid

NEVER = -(1 << 63)
POINTS = 3
BLIND_S, LIKELY = 5.0, 0.5
IDLE_SAMPLES = 20
CLASSES = {
    "overheating": FaultClass.OVERHEATING, "cooling_loss": FaultClass.COOLING_LOSS,
    "bearing_de": FaultClass.BEARING, "bearing_nde": FaultClass.BEARING,
    "winding_resistance": FaultClass.WINDING_RESISTANCE,
}  # fmt: skip
NOTHING = (FaultClass.UNKNOWN, FaultSensor.NONE)
NOT_JUDGED = (Flag.UNKNOWN, None, Reason.CONFIG, *NOTHING)


def words(motor, kind, unexplained=False, cut_out=False):
    """Thermal and sensor evidence, reason, class, whose sensor; sensor None: the model tells none.

    motor: one `struct thermal_motor`; kind (11,): `ThermalMonitor.kinds`;
    unexplained: its model did not hold at calibration. A motor that is cut out has no model.
    """
    if motor["unknown_s"] > BLIND_S:
        return Flag.UNKNOWN, None, Reason.STALE, *NOTHING
    if unexplained or cut_out:
        return Flag.UNKNOWN, None, Reason.CONFIG, *NOTHING
    if not motor["judged"]:
        return Flag.UNKNOWN, None, Reason.STARTING, *NOTHING
    if not np.isfinite(motor["off_k"]).any():
        return Flag.UNKNOWN, None, Reason.TOO_FEW_DRIVES, *NOTHING
    if not motor["held"] and not motor["step"]["offset_k"].any():
        if motor["fault_probability"] > LIKELY:
            return Flag.UNKNOWN, None, Reason.DIVERGED, *NOTHING
        return Flag.GOOD, None, Reason.NONE, FaultClass.NONE, FaultSensor.NONE
    whose, heat = int(side(kind)), CLASSES[KINDS[int(kind[: len(HEAT)].argmax())]]
    sensor = FaultSensor(int(kind[len(HEAT) :].argmax()) % POINTS + 1)
    seen = np.isfinite(motor["step"]["level_k"]).sum()
    if seen > 1 and (motor["step"]["offset_k"] != 0.0).sum() >= seen:
        sensor = FaultSensor.NONE
    if whose > 0:
        return Flag.BAD, None, Reason.NONE, heat, FaultSensor.NONE
    # A sensor that has stepped for certain is no alternative to heat.
    stepped = np.tile(motor["step"]["offset_k"] != 0.0, 2)
    beside = motor["kind"].copy()
    beside[len(HEAT) :][stepped] = 0.0
    hot = motor["held"] and beside[: len(HEAT)].sum() > LIKELY and int(side(beside)) > 0
    if stepped.any() and hot:
        return Flag.BAD, Flag.BAD, Reason.NONE, heat, sensor
    if whose == 0:
        tested = (motor["step"]["since"] >= 0).any()
        thermal = Flag.UNKNOWN if tested else Flag.BAD
        return thermal, Flag.UNKNOWN, Reason.DIVERGED, *NOTHING
    return Flag.UNKNOWN, Flag.BAD, Reason.NOT_AVAILABLE, FaultClass.SENSOR_BIAS, sensor


def beside_fault(kind, whose, told):
    """The same of a motor with a faulty sensor; told: `words` of its model, whose heat counts."""
    thermal, _, why, heat, _ = told
    if thermal is Flag.BAD and heat is not FaultClass.UNKNOWN:
        return thermal, Flag.BAD, why, heat, whose
    return Flag.UNKNOWN, Flag.BAD, Reason.NOT_AVAILABLE, kind, whose


class Temperatures:
    """Of all motors, beside a `TemperatureMonitor` whose sensors and monitor it looks at."""

    def __init__(self, side, calibration, nodes, window, every, limits, driven_a):
        n = len(side.motors)
        self.side, self.every, self.limits = side, every, limits
        self.period = int(side.record["period_ns"][0])
        self.calibration = calibration
        self.gain, self.offset = np.ones((n, POINTS)), np.zeros((n, POINTS))
        if calibration is not None:
            self.gain, self.offset = calibration.centring(nodes)
        self.ring = []
        self.window, self.cycles, self.due, self.at = window, 0, None, 0
        self.ambient = np.full(n, np.nan)
        self.rows = [[] for _ in range(n)]
        self.mean = np.full((n, POINTS + 3), np.nan)
        self.kept, self.until = [None] * n, [NEVER] * n
        self.driven_a = driven_a
        self.square, self.cut_out, self.left_out = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
        self.idle = np.zeros(n, int)
        self.averages = self.known = self.deviation = None
        self.spread = np.full(POINTS, np.nan)

    def tick(self, received, now, loads):
        """After the sensors have got their readings. loads (N, 2): current and speed, NaN: none."""
        if received and self.due is None:
            self.due = now
        if self.due is None or now < self.due:
            return
        self.due += self.period * (1 + (now - self.due) // self.period)
        self.until = [NEVER] * len(self.until)
        valid = sensors_valid(self.side.sensors, now)
        values = self.side.sensors.drives["sensor"]["value_c"]
        self._second(valid, values, loads)
        # What has stepped and is not decided yet stays out of the averages.
        decided = self.side.sensors.drives["sensor"]["step_count"] == 0
        self.ring = [*self.ring, np.where(valid & decided, values, np.nan)][-self.window :]
        seen = np.isfinite(self.ring)
        count = seen.sum(axis=0)
        total = np.where(seen, self.ring, 0.0).sum(axis=0)
        self.averages = total / np.maximum(count, 1)
        self.known = (2 * count >= self.window) & valid
        with np.errstate(divide="ignore", invalid="ignore"):
            centred = (self.averages - self.offset) / self.gain
        self._leave_out(centred)
        compared = self.known & ~self.left_out[:, None]
        self.spread, learnt = maisd.compare(centred, compared)
        same = maisd.compare(self.averages, compared)[1]
        nearer = np.where(np.abs(same) < np.abs(learnt), same, learnt)
        opposed = np.isfinite(learnt) & ((same > 0) != (learnt > 0))
        self.deviation = np.where(opposed, 0.0, nearer)
        self.cycles += 1

    def _leave_out(self, centred):
        """Motors that are cut out, or were and are colder than every driven one less the limit."""
        if self.side.model is not None:
            self.cut_out = self.side.currents["cut_out"] == 1
        limit = np.inf if self.calibration is None else self.calibration.deviation_limit_k
        driven = self.known & ~self.left_out[:, None]
        coolest = np.where(driven, centred, np.inf).min(axis=0)
        with np.errstate(invalid="ignore"):
            colder = self.known & (centred < coolest - limit)
        cold = colder.any(axis=1) | ~self.known.any(axis=1)
        self.left_out = self.cut_out | self.left_out & cold

    def _second(self, valid, values, loads):
        for j, (good, celsius) in enumerate(zip(valid, values, strict=True)):
            row = np.full(POINTS + 3, np.nan)
            row[:POINTS] = np.where(good, celsius, np.nan)
            row[POINTS], row[POINTS + 1] = 2.0 * loads[j, 0] ** 2, abs(loads[j, 1])
            row[POINTS + 2] = self.ambient[j] if good.any() else np.nan
            self.rows[j].append(row)
        self.at += 1
        if self.at < self.every:
            return
        self.at = 0
        for j, rows in enumerate(self.rows):
            with np.errstate(invalid="ignore"):
                there = np.isfinite(rows).sum(axis=0)
                self.mean[j] = np.nansum(rows, axis=0) / np.where(there, there, np.nan)
        self.rows = [[] for _ in self.rows]
        measured = np.isfinite(self.mean[:, POINTS])
        square = np.minimum(self.mean[:, POINTS], (100.0 * self.driven_a) ** 2)
        self.square[measured] += (square - self.square)[measured] / 30.0
        highest = square[measured].max(initial=0.0)
        if highest > self.driven_a**2:
            without = square < highest / 400.0  # false without a value
            self.idle = np.where(without, self.idle + 1, np.where(measured, 0, self.idle))
        largest = self.square[measured].max(initial=0.0)
        if largest > self.driven_a**2:
            self.cut_out = (self.square < largest / 400.0) | (self.idle >= IDLE_SAMPLES)

    def report(self, j, now):
        """Evidence of one motor: flags, reason, class, sensor, temperature and MAISD."""
        received = int(self.side.sensors.drives["received_ns"][j])
        if received == NEVER or now - received > self.limits[j]:
            why = Reason.STARTING if received == NEVER else Reason.STALE
            return Flag.UNKNOWN, Flag.UNKNOWN, why, *NOTHING, math.nan, math.nan
        if now >= self.until[j]:
            self.kept[j], self.until[j] = self._judge(j, now), now + self.period
        return self.kept[j]

    def _judge(self, j, now):
        mixed = largest = math.nan
        if self.averages is not None and self.known[j].any():
            mixed = self.averages[j][self.known[j]].mean()
        if np.isfinite(self.spread).any():
            largest = np.nanmax(self.spread)
        sensors = self.side.sensors
        kind, whose = sensor_verdict(sensors, j, now)
        if kind is not FaultClass.NONE:
            told = NOT_JUDGED if self.side.model is None else self._by_model(j)
            return *beside_fault(kind, whose, told), mixed, largest
        sensor = Flag.UNKNOWN if not_yet_valid(sensors, j) else Flag.GOOD
        if self.calibration is None:
            thermal, own, why, *fault = NOT_JUDGED
        elif self.side.model is None:
            thermal, own, why, *fault = self._unlike(j)
        else:
            thermal, own, why, *fault = self._by_model(j)
        return thermal, sensor if own is None else own, why, *fault, mixed, largest

    def _by_model(self, j):
        monitor, out = self.side.model, bool(self.cut_out[j])
        return words(monitor.motors[j], monitor.kinds()[0][j], cut_out=out)

    def _unlike(self, j):
        if self.left_out[j]:
            why = Reason.CONFIG if self.cut_out[j] else Reason.STARTING
            return Flag.UNKNOWN, None, why, *NOTHING
        fitted = self.side.sensors.configured[j]
        if self.known is None or not self.known[j][fitted].all():
            return Flag.UNKNOWN, None, Reason.STARTING, *NOTHING
        if not np.isfinite(self.deviation[j][fitted]).all():
            return Flag.UNKNOWN, None, Reason.TOO_FEW_DRIVES, *NOTHING
        learnt = self.calibration
        hot = (self.deviation[j] > learnt.deviation_limit_k) & (self.spread > learnt.maisd_limit_k)
        moved = self.side.sensors.drives["sensor"]["moved"] == 1
        compared = self.known & ~self.left_out[:, None]
        beside = (moved & compared).sum(axis=0) - (moved & compared)[j]
        if hot.any() and not (hot & moved[j] & (beside > 0)).any():
            return Flag.UNKNOWN, None, Reason.STARTING, *NOTHING
        hot = hot & moved[j] & (beside > 0)
        near = self.side.sensors.drives["sensor"]["near"][j] == 1
        if hot.sum() == 1 and not (hot & near).any():
            return Flag.UNKNOWN, Flag.UNKNOWN, Reason.DIVERGED, *NOTHING
        kind = FaultClass.BEARING if hot.any() else FaultClass.NONE
        if hot[0]:
            kind = FaultClass.COOLING_LOSS if hot[1:].any() else FaultClass.OVERHEATING
        flag = Flag.BAD if hot.any() else Flag.GOOD
        return flag, None, Reason.NONE, kind, FaultSensor.NONE
