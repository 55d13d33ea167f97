"""Wheels that run away beside others are never `Adhering` for long; steady ones are no liars."""

import numpy as np
import pytest

from gateway.core.codes import Flag
from sim.physics.plant import MOTORS
from tests.hil.chain import for_slower_bus
from tests.simrun import CLASSIC, FD_FILE, codec, flags_and_speeds, scenario

MOST_TICKS = 20


def loss(drive, at_s):
    """A quarter, within 6 s: the load alone shows it late."""
    return {"at_s": at_s, "drive": drive, "kind": "adhesion_loss", "depth": 0.25, "ramp_s": 6.0}


def running_away(seconds, events, drives, nm=18.0, **config):
    """Flags and speeds; nothing limits the slip."""
    run = scenario(
        seed=5, duration_s=seconds, drives=drives, slip_limiter="none", event=events,
        motion={"profile": [(0.0, 200.0)]}, load={"torque_nm": nm},
    )  # fmt: skip
    return flags_and_speeds(run, codec(tuple(range(1, drives + 1))), **config)


def longest_good(flags, speeds, drive, train):
    """Ticks in a row: drive is called adhering and more than 10 % from a wheel that holds."""
    longest = now = 0
    apart = np.abs(speeds[:, drive] / speeds[:, train] - 1.0) > 0.1
    for wrong in (flags[: len(apart), drive] == Flag.GOOD) & apart:
        now = now + 1 if wrong else 0
        longest = max(longest, now)
    return longest


@pytest.mark.parametrize("drives", [3, 4])
def test_two_wheels_that_run_away_together(drives):
    """Those that hold say the same speed and torque all the time, and are right."""
    flags, speeds = running_away(8.0, [loss(1, 4.0), loss(2, 4.0)], drives)
    assert speeds[-1, 0] > 1.5 * speeds[-1, -1]
    for drive in (0, 1):
        assert longest_good(flags, speeds, drive, drives - 1) <= MOST_TICKS
        assert (flags[200:400, drive] == Flag.GOOD).all()
    assert not (flags[:, 2:] == Flag.BAD).any()


@pytest.mark.parametrize("nm", [18.0, -18.0])
def test_one_of_two_in_the_first_seconds_of_adhering(nm):
    """Its diameter is not known yet, and the slip is not learnt for one."""
    flags, speeds = running_away(4.0, [loss(1, 1.0)], 2, nm)
    assert abs(speeds[-1, 0] / speeds[-1, 1] - 1.0) > 0.2
    assert longest_good(flags, speeds, 0, 1) <= MOST_TICKS


def test_a_motor_measured_a_little_unlike_the_others():
    keys = ("R_s", "L_s", "psi_pm", "pole_pairs", "J", "I_rated", "T_rated")
    motor = {key: getattr(MOTORS["bench"], key) for key in keys}
    motor["psi_pm"] *= 1.001
    drives = [{"node": 1, "motor": "measured"}, {"node": 2}, {"node": 3}]
    flags, speeds = running_away(9.0, [loss(1, 4.0)], 3, motor={"measured": motor}, drive=drives)
    assert speeds[-1, 0] > 1.5 * speeds[-1, 2]
    assert longest_good(flags, speeds, 0, 2) <= MOST_TICKS


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_those_that_hold_are_known_beside_one_that_brakes_until_it_turns_backwards(way):
    """Backwards it becomes as fast as they are, and faster: still no measure for them."""
    lost = {"at_s": 0.8, "for_s": 1.2, "drive": 2, "kind": "adhesion_loss", "depth": 0.7}
    run = scenario(
        duration_s=2.5, slip_limiter="none", event=[lost], load={"torque_nm": -way * 16.4},
        motion={"start": "rolling", "effort_nm": 24.0, "speed": way * 160.0},
    )  # fmt: skip
    flags, speeds = flags_and_speeds(run, codec())
    stops = 80 + int(speeds[80:200, 1].argmin())
    assert speeds[stops, 1] < 2.0 < speeds[stops, 0]
    assert (speeds[stops:, 1] > speeds[stops:, 0]).sum() > 10, "faster than the train"
    assert (flags[50:, [0, 2]] == Flag.GOOD).all()
    assert (flags[100:, 1] == Flag.BAD).all(), "it is not back yet"


@pytest.mark.parametrize(
    ("motor", "nm", "speed"),
    [("bench", 18.0, 320.0), ("bench", 18.0, 400.0), ("traction_350kw", 480.0, 800.0)],
)
def test_an_honest_train_on_can_fd_is_adhering_at_every_speed(motor, nm, speed):
    """One of ten `Motion` frames waits for the bus by a millisecond: no sign of a late current."""
    nodes = (1, 2, 3)
    run = scenario(
        seed=11, duration_s=2.0, motor={"name": motor}, load={"torque_nm": nm},
        motion={"start": "rolling", "profile": [[0.0, speed]]},
    )  # fmt: skip
    drives = [{"node": node, "motor": motor} for node in nodes]
    flags, _ = flags_and_speeds(run, codec(nodes, FD_FILE), drive=drives)
    assert (flags[50:] == Flag.GOOD).all()


@pytest.mark.parametrize("path", [CLASSIC, FD_FILE])
@pytest.mark.parametrize("drives", [2, 3])
def test_those_that_hold_beside_one_that_lets_go_are_known(drives, path):
    """At 25 rad/s a wheel without a rail jumps by 12 % in a tick; the others' speeds do not."""
    nodes = tuple(range(1, drives + 1))
    lost = {"at_s": 2.5, "for_s": 1.0, "drive": 1, "kind": "adhesion_loss", "depth": 1.0}
    run = scenario(seed=10, drives=drives, event=[lost])
    flags, _ = flags_and_speeds(run, codec(nodes, path))
    first = int(np.argmax((flags == Flag.GOOD).all(axis=1)))
    assert first < 50
    assert (flags[first:, 1:] == Flag.GOOD).all()
    assert (flags[260:340, 0] == Flag.BAD).all()


def test_a_drive_that_is_found_again_puts_nobody_in_doubt(tmp_path):
    """Its speed is a guess at first, up to 10 % off where there are few samples."""
    dbc = for_slower_bus(CLASSIC, tmp_path)
    nodes = (1, 2, 3)
    for seed in range(1, 4):
        opened = {"at_s": 2.0, "for_s": 1.0, "drive": 1, "kind": "phase_open"}
        flags, _ = flags_and_speeds(scenario(seed=seed, event=[opened]), codec(nodes, dbc))
        assert (flags[100:, 1:] == Flag.GOOD).all(), seed
        assert (flags[400:, 0] == Flag.GOOD).all(), seed


@pytest.mark.parametrize(("path", "drives"), [(CLASSIC, 3), (FD_FILE, 2)])
def test_a_sender_that_has_a_processor_now_and_then_is_no_fault(path, drives):
    """Its frames come late and at once, as from a simulated drive on a busy machine."""
    nodes = tuple(range(1, drives + 1))
    waits_ms = np.random.default_rng(7).choice([2.1, 4.2, 5.3], 20_000, p=[0.96, 0.03, 0.01])
    wakes = np.cumsum(waits_ms * 1e6).astype(np.int64)
    waiting = []

    def late(frames, now):
        for frame in frames:
            wake = int(wakes[np.searchsorted(wakes, frame.t_ns)])
            waiting.append(frame._replace(t_ns=wake))
        come = [frame for frame in waiting if frame.t_ns <= now]
        waiting[:] = [frame for frame in waiting if frame.t_ns > now]
        return come

    run = scenario(seed=3, drives=drives, duration_s=12.0)
    flags, _ = flags_and_speeds(run, codec(nodes, path), late)
    assert (flags[100:] == Flag.GOOD).all()


def test_the_one_of_two_that_holds_adheres_beside_one_that_is_flagged():
    """A wheel that is known to slide is no measure for the other."""
    flags, speeds = running_away(3.0, [{**loss(1, 1.5), "depth": 1.0, "ramp_s": 0.0}], 2)
    assert speeds[-1, 0] > 1.5 * speeds[-1, 1]
    assert longest_good(flags, speeds, 0, 1) <= MOST_TICKS
    assert (flags[155:, 0] == Flag.BAD).all()
    assert (flags[50:, 1] == Flag.GOOD).all()


def starting(nm, seconds=6.0, **more):
    """A train that starts from standstill; half of what drive 2 carries is lost for a second."""
    lost = {"at_s": 2.0, "for_s": 1.0, "drive": 2, "kind": "adhesion_loss", "depth": 0.5}
    return scenario(
        seed=3, duration_s=seconds, event=[lost], load={"torque_nm": nm},
        motion={"start": "standstill", "profile": [(0.0, 0.0), (1.0, 0.0), (seconds, 4.0)]}, **more
    )  # fmt: skip


@pytest.mark.parametrize("nm", [18.0, -18.0])
def test_a_train_that_starts_is_judged_by_its_motion(nm):
    """Its currents reveal no load below 5 rad/s of these rotors, which it never reaches."""
    flags, speeds = flags_and_speeds(starting(nm), codec())
    assert speeds.max() < 5.0
    assert not (flags[:, [0, 2]] == Flag.BAD).any()
    # Whether the load pulls or brakes is known once they turn.
    assert (flags[50:, [0, 2]] == Flag.GOOD).mean() > 0.98
    assert (flags[50:200, 1] == Flag.GOOD).all()
    assert (flags[210:300, 1] == Flag.BAD).all()
    assert (flags[320:, 1] == Flag.GOOD).all()
