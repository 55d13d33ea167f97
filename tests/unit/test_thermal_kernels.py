"""The thermal side on rows of any sort: of frames, and of a recording."""

from pathlib import Path

import numpy as np
import pytest

from gateway import calibration
from gateway.commands.common import scenario_thermal
from gateway.health import FaultClass, Reason
from gateway.inbox import Inbox
from gateway.said import findings
from gateway.supervision import Supervision
from gateway.thermal import Beside, ThermalSide
from tests.sender import MS, codec_for

NODES = (1, 2, 3)
CODEC = codec_for(NODES)
FITTED = (("stator", "drive_end", "non_drive_end"), ("stator", "non_drive_end"), ("drive_end",))
TOP_C = 300.0


class Bus:
    """Rows of temperatures as the receiver leaves them; what else drives say comes and goes."""

    def __init__(self, seed):
        self.inbox = Inbox(CODEC, NODES, 10 * MS, Supervision(NODES, 300 * MS))
        self.places = self.inbox.places([1.0] * 3)
        self.rng = np.random.default_rng(seed)
        self.level = np.tile([60.0, 50.0, 48.0, 20.0], (3, 1))
        self.off, self.lost = np.zeros((3, 4)), np.zeros((3, 4), dtype=bool)
        self.held = np.zeros((3, 4), dtype=bool)
        self.gone = np.zeros(3, dtype=bool)
        self.now = self.tick = 0

    def _change(self):
        rng = self.rng
        if rng.random() < 0.02:
            self.off[rng.integers(3)] = rng.choice([0.0, 9.0, -9.0, 250.0])
            self.off[rng.integers(3), rng.integers(4)] = rng.choice([0.0, 3.0, 9.0])
        for what in (self.lost, self.held):
            if rng.random() < 0.02:
                what[rng.integers(3), rng.integers(4)] ^= True
            if rng.random() < 0.02:
                what[rng.integers(3)] ^= True
        if rng.random() < 0.02:
            self.gone[rng.integers(3)] ^= True
        if rng.random() < 0.05:
            for what in (self.off, self.lost, self.held, self.gone):
                what[:] = 0
        slow, state = self.inbox.slow, self.inbox.state
        for column in (slow.speed, slow.irms, slow.command):
            column[:] = np.where(rng.random(3) < 0.03, np.nan, rng.normal(0.0, 20.0, 3))
        state.good_ns[:] = self.now - rng.choice([0, 10, 5000], len(state.good_ns)) * MS
        state.reason[:] = rng.choice([Reason.NONE] * 9 + [Reason.STALE], len(state.reason))

    def go_on(self):
        """The next tick's rows."""
        rng, inbox, scratch = self.rng, self.inbox, self.inbox.scratch
        self._change()
        self.tick += 1
        hole = self.tick % 700 == 0
        self.now += 12_000 * MS if hole else int(rng.choice([10] * 20 + [7, 40])) * MS
        self.level[:, :3] += rng.normal(0.02, 0.01, (3, 3)) * (self.tick < 400)
        inbox.seen = 0
        for j, drive in enumerate(inbox.drives):
            if self.gone[j] or (self.tick + 3 * j) % 10:
                continue
            channel = drive.channels["Temperatures"]
            row = 2 * j + 1
            scratch.seen[inbox.seen] = row
            inbox.seen += 1
            scratch.channel[row], scratch.t_ns[row] = channel.row, self.now - MS
            picked = list(channel.picked)
            shaky = np.where(self.held[j], 0.0, rng.normal(0.0, 0.15, 4))
            celsius = np.minimum(np.round(self.level[j] + self.off[j] + shaky, 1), TOP_C)
            scratch.value[row, picked] = celsius
            scratch.validity[row, picked] = np.where(self.lost[j], rng.integers(1, 4, 4), 0)
            scratch.value[row, channel.quality] = rng.choice([1.0] * 40 + [0.0, 2.0, 3.0])


def cells():
    return calibration.load(Path(scenario_thermal()["calibration"]), NODES, 5.0)


def numbers(parts):
    return [np.array(part) for table in parts for part in table]


def run(method, seed, ticks, how):
    """What every tick leaves, and what was told. how(side, bus): feeds a tick."""
    learnt = None if method == "none" else cells()
    side = ThermalSide(3, 100 * MS, 5.0, learnt, NODES, FITTED, model=method == "model")
    side.learning = True
    bus, out, left, met = Bus(seed), findings(3), [], set()
    limits = np.array([310 * MS, 310 * MS, 150 * MS])
    for _ in range(ticks):
        bus.go_on()
        how(side, bus)
        side.tell(bus.now, limits, out)
        w = side.warmth
        parts = numbers((w.seconds, w.averages, w.model, w.kept, out))
        left.append([*parts, w.kept_ns.copy(), w.fresh.copy(), w.beat.copy()])
        met |= {(int(out.reason[k]), int(out.fault_class[k])) for k in range(3)}
    return left, met


def heard(side, bus):
    side.hear(bus.inbox, bus.places, bus.now)


def taken(side, bus):
    inbox = bus.inbox
    side.take(inbox.temperatures, bus.now, Beside(bus.places, inbox.state, inbox.slow))


def check(ones, others):
    for one, other in zip(ones, others, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("method", "seed"), [("none", 1), ("maisd", 2), ("model", 3)])
def test_rows_of_frames_and_readings_of_a_recording_are_the_same(method, seed):
    ones, met = run(method, seed, 3000, heard)
    others, same = run(method, seed, 3000, taken)
    assert met == same
    check(ones, others)
    classes = {FaultClass(kind) for _, kind in met}
    assert {FaultClass.SENSOR_BIAS, FaultClass.SENSOR_LOST} <= classes
    assert {Reason.STALE, Reason.NOT_AVAILABLE} <= {Reason(reason) for reason, _ in met}
