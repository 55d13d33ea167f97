"""Which sensors a drive has, and whose fault it is when all of them fail together."""

import numpy as np
import pytest

from gateway.core.codes import FaultClass, FaultSensor, Flag
from gateway.core.temperature import SensorMonitor
from gateway.study.calibrating import Learner
from gateway.study.temperature_reader import CycleLog
from tests.fleet_limits import motor
from tests.stations import (
    TemperatureMonitor,
    Temperatures,
    add_reading,
    not_yet_valid,
    sensor_verdict,
    sensors_valid,
)

MS = 1_000_000
HEALTHY = ((FaultClass.NONE, FaultSensor.NONE),)


class Rig:
    """One drive at 10 readings a second."""

    def __init__(self, sensors=None):
        self.side = SensorMonitor(1, 100 * MS, sensors=None if sensors is None else [sensors])
        self.rng = np.random.default_rng(2)
        self.k = 0

    def run(self, readings, offsets=(0.0, 0.0, 0.0), lost=()):
        """Verdicts of the readings, each once, in the order in which they came."""
        said = []
        for _ in range(readings):
            self.k += 1
            noise = self.rng.normal(scale=0.15, size=3)
            celsius = np.round(np.array([60.0, 50.0, 48.0]) + noise + offsets, 1)
            good = (*(p not in lost for p in range(3)), True)
            raw = tuple(round(10 * c) for c in celsius)
            now = self.k * 100 * MS
            add_reading(self.side, Temperatures(0, now, (*celsius, 20.0), good, (*raw, 200)))
            found = sensor_verdict(self.side, 0, now)
            if not said or said[-1] != found:
                said.append(found)
        return tuple(said)


def healthy(sensors=None):
    """One whose sensors have been well for 5 s."""
    rig = Rig(sensors)
    assert rig.run(50) == HEALTHY
    return rig


def bias(sensor):
    return FaultClass.SENSOR_BIAS, sensor


@pytest.mark.parametrize(
    ("offsets", "named"),
    [
        ((9, 9, 9), FaultSensor.NONE), ((9, -9, 30), FaultSensor.NONE),
        ((-5, -5, -5), FaultSensor.NONE), ((0, 9, 9), FaultSensor.DRIVE_END),
        ((240.0, 0, 0), FaultSensor.STATOR),
    ],
)  # fmt: skip
def test_sensors_that_jump_together_have_a_common_source_and_two_of_three_are_two(offsets, named):
    """To the end of the range, too."""
    rig = healthy()
    assert rig.run(20, offsets)[-1] == bias(named)
    assert rig.run(20)[-1] == HEALTHY[0]


def test_jumps_a_second_apart_are_not_common():
    rig = healthy()
    rig.run(10, (9, 0, 0))
    rig.run(10, (9, 9, 0))
    assert rig.run(20, (9, 9, 9))[-1] == bias(FaultSensor.STATOR)


def test_two_readings_apart_are_common_three_are_not():
    for between, named in ((2, FaultSensor.NONE), (3, FaultSensor.STATOR)):
        rig = healthy(("stator", "non_drive_end"))
        rig.run(between, (9, 0, 0))
        assert rig.run(20, (9, 0, 9))[-1] == bias(named)


def test_all_lost_at_once_is_common_one_after_another_is_not():
    rig = healthy()
    assert rig.run(20, lost=(0, 1, 2))[-1] == (FaultClass.SENSOR_LOST, FaultSensor.NONE)
    assert rig.run(20)[-1] == HEALTHY[0]
    rig.run(20, lost=(1,))
    found = rig.run(20, lost=(0, 1, 2))
    assert found[-1] == (FaultClass.SENSOR_LOST, FaultSensor.STATOR)


def test_an_only_sensor_is_named_itself():
    rig = healthy(("drive_end",))
    assert rig.run(20, lost=(1,))[-1] == (FaultClass.SENSOR_LOST, FaultSensor.DRIVE_END)


def test_a_sensor_that_is_not_fitted_takes_part_in_nothing():
    rig = Rig(("stator", "non_drive_end"))
    assert rig.run(50, lost=(1,)) == HEALTHY
    assert not not_yet_valid(rig.side, 0)
    assert sensors_valid(rig.side, rig.k * 100 * MS).tolist() == [[True, False, True]]
    assert rig.run(20, (0, 40, 0)) == HEALTHY
    assert rig.side.drives["sensor"]["value_c"][0, 1] == 0.0
    both = rig.run(20, (9, 0, 9))[-1]
    assert both == bias(FaultSensor.NONE), "all that there are"


@pytest.mark.parametrize("silent_s", [12, 600])
def test_what_has_cooled_while_nothing_was_heard_has_not_jumped(silent_s):
    rig = healthy()
    rig.k += 10 * silent_s
    assert rig.run(50, (-30, -20, -20)) == HEALTHY


def test_the_same_value_before_and_after_a_silence_is_not_held():
    side = SensorMonitor(1, 100 * MS)
    for t_s in (0, 300):
        add_reading(side, Temperatures(0, t_s * 1000 * MS, (60.0,) * 4, (True,) * 4, (600,) * 4))
    assert sensor_verdict(side, 0, 300_050 * MS) == HEALTHY[0]


def test_silence_does_not_clear_an_offset():
    rig = healthy()
    rig.run(20, (0, 9, 0))
    rig.k += 600
    assert rig.run(50, (0, 9, 0)) == (bias(FaultSensor.DRIVE_END),)


def test_a_jump_over_a_short_hole_is_still_one():
    rig = healthy()
    rig.k += 39
    assert rig.run(50, (0, 9, 0))[-1] == bias(FaultSensor.DRIVE_END)


@pytest.mark.parametrize(("step_k", "hold_s"), [(0.2, 240), (0.8, 10)])
def test_a_sensor_without_noise_is_not_held_to_what_it_held_in_health(step_k, hold_s):
    side = SensorMonitor(1, 100 * MS, [motor(1, hold_s=2.0, step_k=step_k)])
    assert side.stuck_after_ns(0, 0) == hold_s * 1000 * MS


def test_motors_with_different_sensors_are_calibrated_and_judged_by_what_they_have():
    nodes, fitted = (1, 2, 3), (("stator",), ("stator", "drive_end"), ("stator", "drive_end"))
    rng = np.random.default_rng(3)

    def play(side, seconds, heat, look=lambda now: None):
        for k in range(1, 10 * seconds + 1):
            now, readings = k * 100 * MS, []
            for j in range(3):
                rise = heat * k / 10 if j == 1 else 0.0
                level = np.array([60.0 + j, 50.0 - 2 * j + rise, -1.0, 20.0])
                celsius = np.round(level + rng.normal(scale=0.15, size=4), 1)
                raw = tuple(round(10 * c) for c in celsius)
                # What is not fitted reads nonsense, as an open input does.
                readings.append(Temperatures(j, now, tuple(celsius), (True,) * 4, raw))
            side.add_readings(readings, now)
            look(now)
        return [side.report(j, now, 310 * MS) for j in range(3)]

    learner = Learner(nodes, 2.0)
    side = TemperatureMonitor(3, 100 * MS, 2.0, None, nodes, fitted)
    log = CycleLog(3)
    play(side, 60, 0.0, lambda now: log.note(side, now))
    learner.begin()
    learner.learn(log.drain(), side.sensors.configured, side.dt_s)
    learnt = learner.finish(1.5)
    assert learnt.motor[0].offset_k[1:] == (0.0, 0.0)
    assert learnt.motor[1].offset_k[1] == pytest.approx(1.0, abs=0.1)
    assert learnt.deviation_limit_k[2] == 1.0, "nobody has one: the floor"
    well = play(TemperatureMonitor(3, 100 * MS, 2.0, learnt, nodes, fitted), 20, 0.0)
    assert {r.thermal for r in well} == {Flag.GOOD}
    ill = play(TemperatureMonitor(3, 100 * MS, 2.0, learnt, nodes, fitted), 20, 0.3)
    assert [r.fault_class for r in ill] == [FaultClass.NONE, FaultClass.BEARING, FaultClass.NONE]


@pytest.mark.parametrize("per_reading", [0.1, 0.3, 0.8, 2.0])
def test_what_warms_reading_by_reading_is_no_sensors_step(per_reading):
    rig = healthy()
    for k in range(60):
        hole = (0,) if 40 <= k < 44 else ()
        assert rig.run(1, (k * per_reading, 0, 0), hole) == HEALTHY, k
    assert rig.run(50, (60 * per_reading, 0, 0)) == HEALTHY, "nor is it when it ends"
    jumped = rig.run(20, (60 * per_reading + 9, 0, 0))[-1]
    assert jumped == bias(FaultSensor.STATOR)


def test_a_motor_that_warms_beyond_what_a_reading_can_say_is_neither_offset_nor_stuck():
    side = SensorMonitor(1, 100 * MS)
    for k in range(6000):
        celsius = (min(60.0 + 0.7 * k, 300.0), 50.0 + 0.1 * (k % 2), 48.0 + 0.1 * (k % 2), 20.0)
        raw = tuple(round(10 * c) for c in celsius)
        now = (k + 1) * 100 * MS
        add_reading(side, Temperatures(0, now, celsius, (True,) * 4, raw))
        assert sensor_verdict(side, 0, now) == HEALTHY[0]
