"""Recordings made by others through the thermal side: dead sensors, hot bridges, power-up."""

from pathlib import Path

import numpy as np
import pytest

from bench.real_recordings import (
    BRIDGES,
    HALF_BRIDGES,
    JOINTS,
    LABELS,
    LEG,
    POWER_UP_S,
    holding_rule,
    icub,
    judge,
    judged,
    kona,
    kona_frames,
    learn_icub,
    learn_inverter,
    reading,
    to_accuracy,
)
from bench.real_temperatures import FROZEN_S, deviations, frozen_bridge, hot_bridges, kinds
from dbc.frame import SECOND
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from gateway.settings.calibration import POINTS

PAGE = Path(__file__).parents[2] / "docs" / "real_temperatures.md"
ROLL = JOINTS.index("ankle_roll")
PITCH = JOINTS.index("ankle_pitch")


@pytest.fixture(scope="module")
def leg():
    return icub()


@pytest.fixture(scope="module")
def leg_said(leg):
    return judge(leg, LEG, learn_icub(60.0))


@pytest.fixture(scope="module")
def learnt():
    return learn_inverter()


@pytest.fixture(scope="module")
def bridges(learnt):
    return judged(to_accuracy(learnt))


def test_readings_are_what_the_inbox_would_make_of_them():
    found = reading(0, 5, [300.0, 300.1, -60.0])
    assert found.valid == (True, False, True, False)
    assert found.raw == (3000, -1, -600, -1)
    assert np.isnan(found.celsius[1])


# A robot's leg: sentinel codes and an open sensor


def test_an_open_sensor_at_2727_degrees_is_lost_and_never_hot(leg, leg_said):
    assert not any(r.valid[0] for r in leg if r.drive == ROLL)
    assert kinds(leg_said, ROLL) == {FaultClass.SENSOR_LOST}
    assert set(leg_said.which[leg_said.kind[:, ROLL] == FaultClass.SENSOR_LOST, ROLL]) == {
        FaultSensor.STATOR
    }
    assert (leg_said.thermal[:, ROLL] == Flag.UNKNOWN).all()
    lost_s = leg_said.t_s[leg_said.sensor[:, ROLL] == Flag.BAD]
    assert lost_s[0] < 1.0
    assert (leg_said.sensor[leg_said.t_s >= lost_s[0], ROLL] == Flag.BAD).all()


def test_a_dead_neighbour_and_codes_of_a_moment_leave_the_other_joints_well(leg, leg_said):
    invalid = {r.drive for r in leg if not r.valid[0]}
    assert invalid == {ROLL, PITCH}, "the codes are in the recording"
    for k in range(ROLL):
        assert not kinds(leg_said, k), JOINTS[k]
    assert not (leg_said.sensor[:, :ROLL] == Flag.BAD).any()
    assert not (leg_said.thermal == Flag.BAD).any()
    assert (leg_said.thermal[:, :ROLL] == Flag.GOOD).mean() > 0.95


def test_a_code_that_nobody_mapped_is_the_sensors_fault_and_not_heat():
    said = judge(icub(codes=()), LEG, learn_icub(60.0))
    assert kinds(said, PITCH) == {FaultClass.SENSOR_BIAS}
    assert not (said.thermal == Flag.BAD).any()


def test_sensors_that_hold_for_minutes_are_not_stuck_unlearnt(leg):
    said = judge(leg, LEG)
    assert not any(kinds(said, k) for k in range(ROLL))


@pytest.mark.thorough  # with what a minute taught: the joints that are well, above
@pytest.mark.parametrize("learnt_s", [10.0, 30.0])
def test_sensors_that_hold_for_minutes_are_not_stuck_by_what_seconds_taught(leg, learnt_s):
    cells = learn_icub(learnt_s)
    stuck = judge(leg, LEG, holding_rule(cells)).kind == FaultClass.SENSOR_STUCK
    assert stuck.any(), "the longest hold of these seconds is no limit"
    said = judge(leg, LEG, cells)
    assert not (said.kind == FaultClass.SENSOR_STUCK).any()


# An inverter: which half-bridge is hot


@pytest.mark.parametrize("label", LABELS)
def test_the_hot_half_bridge_is_named_and_the_others_are_silent(bridges, label):
    hot = {"F6": "HB1", "F8": "HB3"}.get(label)
    said = bridges[label]
    assert hot_bridges(said) == ([hot] if hot else [])
    assert not (said.sensor == Flag.BAD).any()
    rows = [line.split(" | ")[:2] for line in PAGE.read_text().splitlines()]
    assert [cell for head, *cell in rows if head.startswith(f"| {label} ")] == [[deviations(said)]]
    for k, name in enumerate(BRIDGES):
        wanted = Flag.BAD if name == hot else Flag.GOOD
        assert (said.thermal[said.t_s > 5.0, k] == wanted).mean() > 0.9
        assert kinds(said, k) == ({FaultClass.OVERHEATING} if name == hot else set())


def test_limits_from_one_recording_alone_find_what_is_hot_and_nothing_else(learnt):
    assert learnt.deviation_limit_k[0] == pytest.approx(2.0, abs=0.1)
    hot = {label: hot_bridges(said) for label, said in judged(learnt).items()}
    assert {label: found for label, found in hot.items() if found} == {"F6": ["HB1"], "F8": ["HB3"]}


def test_a_hole_says_unknown_and_clears_nothing(bridges):
    said = bridges["F6"]
    hole = (said.reason == Reason.STALE).all(axis=1)
    t_s = said.t_s[hole]
    assert t_s[-1] - t_s[0] == pytest.approx(3.92 - 0.4, abs=0.2)
    assert (said.thermal[hole, 0] == Flag.BAD).all()
    assert (said.thermal[hole, 1:] == Flag.UNKNOWN).all()
    behind = said.t_s > t_s[-1] + 0.2
    assert (said.thermal[behind] == [Flag.BAD, Flag.GOOD, Flag.GOOD]).all()
    assert not (said.sensor == Flag.BAD).any()


def test_a_frozen_sensor_amid_real_noise_is_stuck_within_what_was_learnt(learnt):
    said = judge(frozen_bridge(), HALF_BRIDGES, learnt)
    assert [kinds(said, k) for k in range(3)] == [set(), {FaultClass.SENSOR_STUCK}, set()]
    found_s = said.t_s[said.kind[:, 1] == FaultClass.SENSOR_STUCK][0]
    assert 9.0 < found_s - FROZEN_S < 11.0
    assert not (said.thermal == Flag.BAD).any()


# An electric car's inverter: defaults at power-up, codes


@pytest.mark.parametrize("since_s", [0.0, POWER_UP_S])
def test_a_default_at_power_up_is_no_temperature(since_s):
    frames = [f for f in kona_frames() if f.t_ns >= since_s * SECOND]
    readings = kona(frames)
    silent = [r for r in readings if not any(r.valid)]
    assert len(silent) == 17
    assert min(min(r.celsius[:3]) for r in readings if r.valid[0]) > 25.0, "no default, no ramp"
    said = judge(readings, [POINTS])
    assert not kinds(said, 0)
    assert not (said.sensor == Flag.BAD).any()
    assert not (said.thermal == Flag.BAD).any()
    assert said.sensor[-1, 0] == Flag.GOOD


def test_the_default_taken_for_a_temperature_is_a_fault_of_what_the_sensors_share():
    said = judge(kona(kona_frames(), status=False), [POINTS])
    assert kinds(said, 0) == {FaultClass.SENSOR_BIAS}
    assert set(said.which[:, 0]) == {FaultSensor.NONE}
    assert not (said.thermal == Flag.BAD).any()


@pytest.mark.parametrize(
    ("points", "named"), [((1,), FaultSensor.DRIVE_END), ((0, 1, 2), FaultSensor.NONE)]
)
def test_ff_is_not_available_and_never_215_degrees(points, named):
    frames = []
    for frame in kona_frames():
        data = bytearray(frame.data)
        if frame.t_ns >= (POWER_UP_S + 3) * SECOND:
            for k in points:
                data[2 + k] = 0xFF
        frames.append(frame._replace(data=bytes(data)))
    readings = kona(frames)
    assert np.nanmax([r.celsius[:3] for r in readings]) < 40.0
    said = judge(readings, [POINTS])
    assert kinds(said, 0) == {FaultClass.SENSOR_LOST}
    assert set(said.which[said.kind[:, 0] == FaultClass.SENSOR_LOST, 0]) == {named}


# All of them


@pytest.mark.thorough  # recording by recording: above
def test_in_all_the_hours_that_there_are_nothing_is_false(leg, bridges):
    """As the page says in its first lines, with the hours."""
    runs = bridges | {
        "leg": judge(leg, LEG, learn_icub()),
        "car": judge(kona(kona_frames()), [POINTS]),
    }
    hours = sum(float(said.t_s[-1]) for said in runs.values()) / 3600.0
    assert f"Together, {hours:.2f} hours are judged" in PAGE.read_text()
    hot = {label for label, said in runs.items() if (said.thermal == Flag.BAD).any()}
    faulty = {label for label, said in runs.items() if (said.sensor == Flag.BAD).any()}
    assert (hot, faulty) == ({"F6", "F8"}, {"leg"})
    assert (runs["leg"].sensor == Flag.BAD).any(axis=0).nonzero()[0].tolist() == [ROLL]
