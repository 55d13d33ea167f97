"""Sensors that are bad from the first reading on, among motors that are compared: never heat."""

import pytest

from gateway.core.codes import FaultClass, Flag, Reason
from tests.fleet_limits import calibration, motor
from tests.sender import MS
from tests.stations import TemperatureMonitor, Temperatures

PERIOD = 100 * MS


def sound(k):
    return 40.0 + 0.1 * (k % 3)


def replayed(drives, stator, readings=300, end=lambda _, k: sound(k), sensors=None):
    """Reports of every drive after each reading. stator(j, k), end(j, k): of drive j, degC."""
    nodes = tuple(range(1, drives + 1))
    learnt = calibration((motor(node, hold_s=0.2) for node in nodes), 1.0, 3.0)
    monitor = TemperatureMonitor(drives, PERIOD, 2.0, learnt, nodes, sensors)
    out = []
    for k in range(readings):
        now = k * PERIOD
        rows = []
        for j in range(drives):
            celsius = (stator(j, k), end(j, k), sound(k), 20.0)
            raw = tuple(round(10.0 * value) for value in celsius)
            rows.append(Temperatures(j, now, celsius, (True,) * 4, raw))
        monitor.add_readings(rows, now)
        out.append([monitor.report(j, now, 310 * MS) for j in range(drives)])
    return out


@pytest.mark.parametrize("drives", [2, 3, 4, 5])
@pytest.mark.parametrize("value", [-273.2, -56.7, -40.0, 214.0, 300.0])
def test_a_value_that_stands_from_the_start_makes_no_motor_hot(value, drives):
    """What no motor has is a sensor's; what one may have is stuck, 10 s later."""
    reports = replayed(drives, lambda j, k: value if j == 0 else sound(k))
    assert not any(one.thermal is Flag.BAD for row in reports for one in row)
    told = {row[0].fault_class for row in reports[3:60] if row[0].sensor is Flag.BAD}
    impossible = value < -50.0 or value >= 300.0
    assert told == ({FaultClass.SENSOR_BIAS} if impossible else set())
    assert reports[-1][0].sensor is Flag.BAD
    if drives > 2:
        assert all(one.thermal is Flag.GOOD for one in reports[-1][1:])


@pytest.mark.parametrize("value", [-70.0, 300.0])
def test_all_sensors_of_a_drive_are_named_as_one_and_come_back(value):
    """An open connector from power-up; plugged in, the values are a motor's again."""

    def stator(j, k):
        return value if j == 0 and k < 40 else sound(k)

    reports = replayed(3, stator, 42)
    assert reports[39][0].fault_class is FaultClass.SENSOR_BIAS
    assert reports[39][0].sensor is Flag.BAD


@pytest.mark.parametrize("drives", [3, 4, 5])
@pytest.mark.parametrize("rise_k", [-20.0, 20.0])
def test_the_one_that_differs_is_the_one_that_is_named(drives, rise_k):
    """A sensor that is low accuses no other motor; a winding that is hot accuses itself."""

    def stator(j, k):
        return sound(k) + (rise_k * min(k / 200.0, 1.0) if j == 0 else 0.0)

    reports = replayed(drives, stator)
    hot = {j for row in reports for j, one in enumerate(row) if one.thermal is Flag.BAD}
    assert hot == ({0} if rise_k > 0.0 else set())


@pytest.mark.parametrize("drives", [2, 3])
@pytest.mark.parametrize("which", [0, 1])
def test_whichever_motor_is_hot_and_wherever(drives, which):
    def warm(j, k):
        return sound(k) + (0.1 * k if j == which else 0.0)

    for kind, reports in (
        (FaultClass.BEARING, replayed(drives, lambda _, k: sound(k), end=warm)),
        (FaultClass.OVERHEATING, replayed(drives, warm)),
        (FaultClass.COOLING_LOSS, replayed(drives, warm, end=warm)),
    ):
        thermal = [one.thermal for one in reports[-1]]
        assert thermal == [Flag.BAD if j == which else Flag.GOOD for j in range(drives)]
        assert reports[-1][which].fault_class is kind


def test_a_motor_of_fewer_sensors_takes_no_part_where_it_has_none():
    def warm(j, k):
        return sound(k) + (0.1 * k if j == 2 else 0.0)

    fitted = [("stator",), ("stator", "drive_end"), ("stator", "drive_end")]
    last = replayed(3, lambda _, k: sound(k), end=warm, sensors=fitted)[-1]
    assert [one.thermal for one in last[1:]] == [Flag.GOOD, Flag.BAD]


@pytest.mark.parametrize(("off_k", "wanted"), [(3.0, Flag.GOOD), (3.5, Flag.BAD)])
def test_at_the_limit_is_not_beyond_it(off_k, wanted):
    def stator(j, k):
        return (40.0 if k else 39.0) + (off_k if j == 0 else 0.0)

    assert replayed(3, stator, 60)[-1][0].thermal is wanted


def test_a_winding_that_jumps_to_and_fro_is_no_evidence():
    def stator(j, k):
        return sound(k) + (25.0 if j == 0 and k % 3 else 0.0)

    last = replayed(3, stator, 100)[-1][0]
    assert (last.thermal, last.reason) == (Flag.UNKNOWN, Reason.STARTING)


def test_a_motor_that_has_been_seen_to_warm_up_to_the_maximum_is_hot():
    def stator(j, k):
        return min(sound(k) + (3.0 * k if j == 0 else 0.0), 300.0)

    last = replayed(3, stator, 200)[-1][0]
    assert (last.thermal, last.sensor) == (Flag.BAD, Flag.GOOD)


def test_what_alone_moves_is_not_called_hot_beside_sensors_that_stand_still():
    """Others that have given one value only may be no sensors at all."""
    reports = replayed(3, lambda j, k: 40.0 + (0.1 * k if j == 0 else 0.0), 90)
    assert not any(row[0].thermal is Flag.BAD for row in reports)
    assert {row[0].reason for row in reports[70:]} == {Reason.STARTING}
