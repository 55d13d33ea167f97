"""`gateway/core/temperature.c` equals its reference, on sensors that fail in every way."""

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import pointer
from gateway.core.codes import FaultClass, FaultSensor
from gateway.core.temperature import SensorMonitor
from tests.reference import temperature as reference
from tests.stations import (
    Temperatures,
    add_reading,
    not_yet_valid,
    sensor_fault,
    sensor_verdict,
    sensors_valid,
)

MS = 1_000_000
FITTED = (("stator", "drive_end", "non_drive_end"), ("stator", "non_drive_end"), ("drive_end",), ())
FIELDS = {
    "raw": "raw", "changed_ns": "changed_ns", "valid_ns": "valid_ns", "value": "value_c",
    "level": "level_c", "stepped": "step_count", "jump": "step_k", "slope": "slope_k",
    "full": "saturated", "bias_k": "bias_k", "valid_at": "valid_at", "jumped_at": "step_index",
    "seen": "seen",
}  # fmt: skip


class Bus:
    """Readings of four drives whose sensors jump, creep, stop, hold and come back."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.off, self.lost, self.held = np.zeros((4, 3)), np.zeros((4, 3), bool), np.zeros((4, 3))
        self.gone, self.level = np.zeros(4, bool), 60.0
        self.now = 0

    def readings(self):
        rng = self.rng
        self.now += int(rng.choice([100] * 30 + [50, 150, 250, 1000])) * MS
        if rng.random() < 0.003:
            self.now += int(rng.choice([9, 12, 400])) * 1000 * MS
        j, k = rng.integers(4), rng.integers(3)
        chance = rng.random()
        if chance < 0.02:
            self.off[j, k] = rng.choice([0.0, 3.0, -9.0, 9.0, 238.0])
        elif chance < 0.03:
            self.off[j] = rng.choice([0.0, 9.0])
        elif chance < 0.05:
            self.lost[j, k] ^= True
        elif chance < 0.06:
            self.lost[j] ^= True
        elif chance < 0.09:
            self.held[j, k] = rng.choice([0.0, 1.0])
        elif chance < 0.1:
            self.gone[j] ^= True
        elif chance < 0.12:
            self.off[:], self.lost[:], self.held[:], self.gone[:] = 0.0, False, 0.0, False
        self.level += rng.choice([0.0, 0.0, 0.3]) - 250.0 * (self.level > 304.0)
        for drive in np.flatnonzero(~self.gone).tolist():
            noise = np.where(self.held[drive] > 0.0, 0.0, rng.normal(0.0, 0.15, 3))
            celsius = np.minimum(np.round(self.level + self.off[drive] + noise, 1), 300.0)
            valid = ~self.lost[drive]
            yield Temperatures(
                drive, self.now, (*celsius.tolist(), 20.0), (*valid.tolist(), True),
                (*np.round(10 * celsius).astype(int).tolist(), 200),
            )  # fmt: skip


def compare(side, points, now):
    """All fields, faults, verdicts and values."""
    sensors = side.drives["sensor"]
    for theirs, ours in FIELDS.items():
        np.testing.assert_array_equal(sensors[ours], getattr(points, theirs), err_msg=ours)
    np.testing.assert_array_equal(side.drives["received_ns"], points.heard_ns)
    np.testing.assert_array_equal(side.drives["first_ns"], points.first_ns)
    valid = np.zeros((4, 3), dtype=bool)
    reference.believe(now, points, valid)
    np.testing.assert_array_equal(sensors_valid(side, now), valid)
    met = set()
    for j in range(4):
        faults = [int(sensor_fault(side, j, k, now)) for k in range(3)]
        assert faults == [reference.fault(j, k, now, points) for k in range(3)]
        found = tuple(map(int, sensor_verdict(side, j, now)))
        assert found == reference.verdict(j, now, points)
        assert not_yet_valid(side, j) == reference.booting(j, points)
        met.add(found)
    return met


@pytest.mark.parametrize("seed", range(4))
def test_it_equals_the_reference_to_the_bit(seed):
    side, bus = SensorMonitor(4, 100 * MS, sensors=FITTED), Bus(seed)
    sensors = side.drives["sensor"]
    sensors["stuck_after_ns"] = 1500 * MS
    points = reference.start(
        side.configured, sensors["limit_k"].copy(), sensors["stuck_after_ns"].copy(), 100 * MS
    )  # fmt: skip
    met = compare(side, points, 0)
    for _ in range(2500):
        for reading in bus.readings():
            add_reading(side, reading)
            j, t = reading.drive, reading.t_ns
            reference.note_reading(j, t, points)
            for k in range(3):
                if side.configured[j, k] and reading.valid[k]:
                    value, raw = reading.celsius[k], reading.raw[k]
                    reference.take_point(j, k, t, value, raw, points)
        met |= compare(side, points, bus.now + int(bus.rng.choice([0, 10, 500])) * MS)
    assert {kind for kind, _ in met} == {1, 5, 6, 7}
    assert {(5, 0), (7, 0)} <= met, "a common source"


def test_a_reset_forgets_all_but_what_is_configured():
    side = SensorMonitor(1, 100 * MS)
    before = side.drives.copy()
    for reading in Bus(0).readings():
        if reading.drive == 0:
            add_reading(side, reading)
    assert side.drives.tobytes() != before.tobytes()
    drive = pointer("struct temperature_drive", side.drives)
    assert lib.temperature_received_ns(drive) == side.drives["received_ns"][0]
    lib.temperature_reset(drive)
    assert repr(side.drives.tolist()) == repr(before.tolist())


def test_a_sensor_that_never_gives_a_value_is_lost_after_half_a_second():
    side = SensorMonitor(1, 100 * MS)
    for k in range(1, 8):
        now = 100 * k * MS
        add_reading(side, Temperatures(0, now, (60.0,) * 4, (True, False, True, True), (600,) * 4))
        lost = k > 6
        assert sensor_fault(side, 0, 1, now) == (
            FaultClass.SENSOR_LOST if lost else FaultClass.UNKNOWN
        )
        assert not_yet_valid(side, 0)
        assert sensors_valid(side, now).tolist() == [[True, False, True]]
    assert sensor_verdict(side, 0, now) == (FaultClass.SENSOR_LOST, FaultSensor.DRIVE_END)


def test_a_drive_that_is_silent_for_more_than_three_cycles_has_no_stuck_sensor():
    side = SensorMonitor(1, 100 * MS)
    side.drives["sensor"]["stuck_after_ns"] = 50 * MS
    add_reading(side, Temperatures(0, 0, (60.0,) * 4, (True,) * 4, (600,) * 4))
    assert sensor_fault(side, 0, 0, 50 * MS) is FaultClass.NONE
    assert sensor_fault(side, 0, 0, 51 * MS) is FaultClass.SENSOR_STUCK
    # Four that stand still have no cause in common, as four that are lost at once have.
    assert sensor_verdict(side, 0, 51 * MS) == (FaultClass.SENSOR_STUCK, FaultSensor.STATOR)
    assert sensor_fault(side, 0, 0, 300 * MS) is FaultClass.SENSOR_STUCK
    assert sensor_fault(side, 0, 0, 301 * MS) is FaultClass.NONE


@pytest.mark.parametrize(("before", "after", "silent_ns", "fault"), [
    (60.0, 90.0, 10_000 * MS, FaultClass.SENSOR_BIAS),
    (60.0, 90.0, 10_000 * MS + 1, FaultClass.NONE),
    (280.0, 300.0, 100 * MS, FaultClass.SENSOR_BIAS), (280.1, 300.0, 100 * MS, FaultClass.NONE),
])  # fmt: skip
def test_a_step_after_ten_seconds_or_to_the_maximum_from_five_limits_below(
    before, after, silent_ns, fault
):
    side = SensorMonitor(1, 100 * MS)
    side.drives["sensor"]["limit_k"] = 4.0
    for t, value in ((0, before), *((silent_ns + k * 100 * MS, after) for k in range(3))):
        add_reading(side, Temperatures(0, t, (value,) * 4, (True,) * 4, (round(10 * value),) * 4))
    assert sensor_fault(side, 0, 0, t) is fault


def faults_of(values):
    """The fault after each of these readings, K, every 100 ms; a step is 4 K, stuck is 1 s."""
    side, found = SensorMonitor(1, 100 * MS), []
    side.drives["sensor"]["limit_k"], side.drives["sensor"]["stuck_after_ns"] = 4.0, 1000 * MS
    for t, value in enumerate(values):
        raw = (round(10 * value),) * 4
        add_reading(side, Temperatures(0, 100 * t * MS, (value,) * 4, (True,) * 4, raw))
        found.append(sensor_fault(side, 0, 0, 100 * t * MS))
    return found


@pytest.mark.parametrize(("back", "fault"), [
    (60.0, FaultClass.NONE), (61.9, FaultClass.NONE), (62.2, FaultClass.SENSOR_BIAS),
])  # fmt: skip
def test_a_step_back_by_half_of_the_limit_and_more_ends_an_offset(back, fault):
    found = faults_of([60.0, *[64.1] * 3, *[back] * 3])
    assert found[3] is FaultClass.SENSOR_BIAS
    assert found[-1] is fault


@pytest.mark.parametrize(("held", "fault"), [
    (10, FaultClass.SENSOR_BIAS), (11, FaultClass.NONE),
])  # fmt: skip
def test_a_stuck_sensor_begins_anew_when_it_moves_again(held, fault):
    """What it held is no level from which it could step."""
    found = faults_of([*[60.0] * held, *[70.0, 70.1] * 2])
    assert found[-1] is fault
