"""The thermal side: hot motors and dead sensors are kept apart."""

import numpy as np
import pytest

from dbc.records import FLAG_INPUTS
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from tests.fleet_limits import calibration, motor
from tests.stations import TemperatureMonitor, Temperatures

MS = 1_000_000
NODES = (1, 2, 3)
LEARNT = calibration(map(motor, NODES))


class Rig:
    def __init__(self, learnt, seconds=0):
        """seconds: of health before."""
        self.side = TemperatureMonitor(3, 100 * MS, 2.0, learnt, NODES)
        self.rng = np.random.default_rng(1)
        self.k = 0
        if seconds:
            self.run(seconds)

    def run(self, seconds, change=lambda j, t, values: values, lost=()):
        for _ in range(round(seconds * 10)):
            self.k += 1
            now = self.k * 100 * MS
            readings = []
            for j in range(3):
                noise = np.round(self.rng.normal(scale=0.15, size=4), 1)
                values = np.array([60.0, 50.0, 48.0, 20.0]) + noise
                values = np.round(change(j, self.k / 10, values), 1)
                good = tuple((j, p) not in lost for p in range(4))
                raw = tuple(round(v * 10) if g else -1 for v, g in zip(values, good, strict=True))
                readings.append(Temperatures(j, now, tuple(values), good, raw))
            self.side.add_readings(readings, now)
        return [self.side.report(j, now, 310 * MS) for j in range(3)]


def test_without_calibration_thermal_is_unknown_and_says_config():
    reports = Rig(None).run(10)
    assert {r.thermal for r in reports} == {Flag.UNKNOWN}
    assert {r.reason for r in reports} == {Reason.CONFIG}
    assert {r.sensor for r in reports} == {Flag.GOOD}


def test_healthy_motors_are_good():
    reports = Rig(LEARNT).run(20)
    assert {r.thermal for r in reports} == {Flag.GOOD}
    assert {r.fault_class for r in reports} == {FaultClass.NONE}


@pytest.mark.parametrize(
    ("weights", "kind"),
    [
        ((0, 1, 0), FaultClass.BEARING),
        ((0, 0, 1), FaultClass.BEARING),
        ((1, 0, 0), FaultClass.OVERHEATING),
        ((1, 0.8, 0.8), FaultClass.COOLING_LOSS),
    ],
)
def test_the_hot_motor_and_its_class_are_named(weights, kind):
    rig = Rig(LEARNT, 10)
    slope = np.array([*weights, 0.0]) * 0.3

    def heat(j, t, values):
        return values + slope * (t - 10) if j == 1 else values

    reports = rig.run(20, heat)
    assert [r.thermal for r in reports] == [Flag.GOOD, Flag.BAD, Flag.GOOD]
    assert reports[1].fault_class is kind
    assert reports[1].sensor is Flag.GOOD


def test_a_stuck_sensor_is_a_sensor_fault_not_a_thermal_one():
    rig = Rig(LEARNT, 10)
    stuck = lambda j, t, v: np.array([v[0], 49.7, v[2], v[3]]) if j == 2 else v  # noqa: E731
    reports = rig.run(15, stuck)
    assert reports[2].sensor is Flag.BAD
    assert reports[2].fault_class is FaultClass.SENSOR_STUCK
    assert reports[2].fault_sensor is FaultSensor.DRIVE_END
    assert reports[2].thermal is Flag.UNKNOWN
    assert reports[0].thermal is Flag.GOOD


def test_a_lost_sensor_is_never_a_hot_motor():
    rig = Rig(LEARNT, 10)
    reports = rig.run(3, lost={(0, 0)})
    assert reports[0].fault_class is FaultClass.SENSOR_LOST
    assert reports[0].fault_sensor is FaultSensor.STATOR
    assert reports[0].thermal is Flag.UNKNOWN


def test_a_jump_within_a_reading_is_the_sensors_and_recovers():
    rig = Rig(LEARNT, 10)
    jumped = lambda j, t, v: v + np.array([9.0, 0, 0, 0]) if j == 1 else v  # noqa: E731
    reports = rig.run(10, jumped)
    assert reports[1].fault_class is FaultClass.SENSOR_BIAS
    assert reports[1].thermal is Flag.UNKNOWN
    reports = rig.run(10)
    assert reports[1].sensor is Flag.GOOD


def test_silence_is_stale():
    rig = Rig(LEARNT, 10)
    now = rig.k * 100 * MS + 1_000 * MS
    assert rig.side.report(0, now, 310 * MS).reason is Reason.STALE


@pytest.mark.parametrize("seed", range(6))
def test_what_is_told_is_what_would_be_reported_if_asked_every_tick(seed):
    """Readings that come, fail, stop for good or for a while; ticks of any length."""
    rng = np.random.default_rng(seed)
    told, asked = (TemperatureMonitor(3, 100 * MS, 2.0, LEARNT, NODES) for _ in range(2))
    out, met, now = np.zeros(3, FLAG_INPUTS), set(), 0
    limits = np.array([310 * MS, 310 * MS, 0])
    for side in (told, asked):
        side.motors["age_limit_ns"] = limits
    gone = set()
    for tick in range(1500):
        now += int(rng.choice([10, 10, 10, 7, 40])) * MS
        gone ^= {int(rng.integers(3))} if rng.random() < 0.02 else set()
        readings = []
        for j in set(range(3)) - gone:
            if (tick + 3 * j) % 10 == 0:
                raw = rng.integers(400, 700, 4) * np.where(rng.random(4) < 0.03, -1, 1)
                celsius, valid = tuple((raw / 10).tolist()), tuple((raw >= 0).tolist())
                readings.append(Temperatures(j, now - MS, celsius, valid, tuple(raw.tolist())))
        for side in (told, asked):
            side.add_readings(readings, now)
        told.tell(now, out)
        for k, limit in enumerate(limits.tolist()):
            report = asked.report(k, now, limit)
            assert told.to_report(k, out[k]) == report
            assert out["temperature_ns"][k] == asked.sensors.drives["received_ns"][k]
            met.add(report.reason)
    assert {Reason.STALE, Reason.STARTING} < met
