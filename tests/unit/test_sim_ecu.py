"""What a drive does with the gateway's flags, seen on the bus and in the truth."""

import numpy as np
import pytest

from dbc.frame import FD, Frame
from sim.simulation import Simulation
from tests.simrun import TICK, Flags, codec, scenario, values

GOOD, LOST, UNKNOWN, INVALID = 1, 2, 0, 3
PRESET = {"load": {"kind": "preset", "torque_nm": 20.0}}


class Loop:
    """A simulation that is told its flags every 10 ms; notes each drive's load."""

    def __init__(self, **table):
        self.simulation = Simulation(scenario(**(PRESET | table)), codec())
        self.flags = Flags()
        self.tick = 0
        self.frames = []

    def go(self, seconds, make):
        """`make(flags, now)` gives the frames of each tick; returns loads (n, drives)."""
        for _ in range(round(seconds * 100)):
            rx = make(self.flags, self.tick * TICK)
            self.tick += 1
            self.frames += self.simulation.step(rx, self.tick * TICK)
        rows = self.simulation.truth_rows()
        return np.array([r.load_nm for r in rows]).reshape(-1, 3)


def say(**states):
    return lambda flags, now: [flags.frame(now, **states)]


def quiet(_flags, _now):
    return []


def test_lost_cuts_within_100_ms_and_good_restores_over_1_s():
    loop = Loop()
    loop.go(0.3, say(Adhesion1=GOOD, Adhesion2=GOOD, Adhesion3=GOOD))
    cut = loop.go(0.5, say(Adhesion1=GOOD, Adhesion2=LOST, Adhesion3=GOOD))
    np.testing.assert_allclose(cut[11:, 1], 6.0, atol=0.1)
    assert cut[4, 1] == pytest.approx(13.0, abs=0.2)
    np.testing.assert_allclose(cut[:, [0, 2]], 20.0, atol=0.1)
    back = loop.go(1.2, say(Adhesion1=GOOD, Adhesion2=GOOD, Adhesion3=GOOD))
    assert back[49, 1] == pytest.approx(13.0, abs=0.2)
    assert back[97, 1] < 20.0
    np.testing.assert_allclose(back[101:, 1], 20.0, atol=0.1)


@pytest.mark.parametrize("state", [UNKNOWN, INVALID])
def test_unknown_leaves_the_drive_to_itself(state):
    loop = Loop()
    loop.go(0.2, say(Adhesion1=LOST))
    back = loop.go(1.2, say(Adhesion1=state))
    np.testing.assert_allclose(back[105:, 0], 20.0, atol=0.1)


def test_silence_of_40_ms_leaves_the_drive_to_itself():
    loop = Loop()
    cut = loop.go(0.3, say(Adhesion1=LOST))
    assert cut[-1, 0] == pytest.approx(6.0, abs=0.1)
    still = loop.go(1.3, quiet)
    # The last flag frame came at the start of the last step, 10 ms earlier.
    np.testing.assert_allclose(still[:3, 0], 6.0, atol=0.1)
    assert still[4, 0] > 6.1
    np.testing.assert_allclose(still[110:, 0], 20.0, atol=0.1)


def test_one_flag_frame_in_40_ms_is_enough():
    loop = Loop()
    sparse = loop.go(
        0.8, lambda flags, now: [flags.frame(now, Adhesion1=LOST)] if now % 30_000_000 == 0 else []
    )
    np.testing.assert_allclose(sparse[30:, 0], 6.0, atol=0.1)


def test_bad_frames_are_no_flags():
    def spoilt(flags, now):
        f = flags.frame(now, Adhesion1=LOST)
        return [f._replace(data=bytes([f.data[0] ^ 1]) + f.data[1:])]

    def repeated(flags, now):
        flags.counter = 5
        return [flags.frame(now, Adhesion1=LOST)]

    def short(flags, now):
        return [flags.frame(now, Adhesion1=LOST)._replace(data=b"\x00\x01")]

    def as_fd(flags, now):
        return [flags.frame(now, Adhesion1=LOST)._replace(flags=FD)]

    for make in (spoilt, repeated, short, as_fd):
        load = Loop().go(0.5, make)
        np.testing.assert_allclose(load[:, 0], 20.0, atol=0.1)


def test_flags_do_nothing_before_operational():
    simulation = Simulation(scenario(**PRESET), codec(), self_start=False)
    flags = Flags()
    for tick in range(40):
        simulation.step([flags.frame(tick * TICK, Adhesion1=LOST)], (tick + 1) * TICK)
    assert simulation.truth_rows()[-3].load_nm == pytest.approx(20.0, abs=0.1)


def test_torque_command_is_the_demand_times_the_limiter():
    event = {"at_s": 0.0, "drive": 2, "kind": "adhesion_loss", "depth": 0.5}
    loop = Loop(event=[event])
    loop.go(0.5, say(Adhesion3=LOST))
    rows = [values(loop.frames, f"Drive{n}_Status")[-1] for n in (1, 2, 3)]
    assert [r["TorqueCommand"] for r in rows] == pytest.approx([20.0, 20.0, 6.0], abs=0.2)
    motion = [values(loop.frames, f"Drive{n}_Motion")[-1]["Torque"] for n in (1, 2, 3)]
    assert motion == pytest.approx([20.0, 10.0, 6.0], abs=0.3)


def test_a_silent_drive_hears_nothing():
    event = {"at_s": 0.1, "for_s": 0.4, "drive": 1, "kind": "silent"}
    loop = Loop(event=[event])
    loop.go(0.1, say(Adhesion1=GOOD))
    deaf = loop.go(0.4, say(Adhesion1=LOST))
    np.testing.assert_allclose(deaf[:, 0], 20.0, atol=0.1)
    heard = loop.go(0.3, say(Adhesion1=LOST))
    assert heard[-1, 0] == pytest.approx(6.0, abs=0.1)


def test_foreign_traffic_is_passed_over():
    loop = Loop()
    load = loop.go(0.1, lambda _f, now: [Frame(now, 0x1A0, b"", 2), Frame(now, 0x2A0, bytes(8))])
    np.testing.assert_allclose(load, 20.0, atol=0.1)
