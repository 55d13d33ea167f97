"""Samples left out without counting, gaps and blocks, and samples that were only delayed."""

import numpy as np
import pytest

from dbc.e2e import protect
from gateway.core.channel import Channel
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.core.inbox import MAX_GAP_NS
from gateway.core.supervision import Supervision
from gateway.settings.config import parse
from sim.simulation import Simulation
from tests.sender import CLASSIC, FD_FILE, MS, Sender, SteadyDrive, codec_for
from tests.simrun import TICK, codec, flags_and_speeds, scenario
from tests.stations import Inbox

NODES = (1, 2, 3)
PERIOD_NS = 2 * MS
SECONDS, FROM, LOAD_NM = 5.0, 190, 30.0
"""A tick from which the load is known to 2 Nm."""
HALVES = {
    spec.can_id: spec
    for spec in map(codec(NODES).by_name.get, ("Drive1_PhaseCurrents", "Drive1_StatorVoltages"))
    if spec is not None
}


def ticks(left_out=(), delays_ns=None):
    """Frames tick by tick; of drive 1 samples are not sent, by their number, or come later."""
    run = scenario(
        seed=3, duration_s=SECONDS, motion={"profile": [[0.0, 200.0]]},
        load={"kind": "preset", "torque_nm": LOAD_NM},
    )  # fmt: skip
    simulation = Simulation(run, codec(NODES))
    taken, sent = dict.fromkeys(HALVES, 0), dict.fromkeys(HALVES, 0)
    waiting = []
    for now in range(TICK, round(SECONDS * 1e9) + 1, TICK):
        for frame in simulation.step((), now):
            can_id, t_ns, data = frame.can_id, frame.t_ns, bytearray(frame.data)
            if can_id in HALVES:
                number = taken[can_id]
                taken[can_id] += 1
                if number in left_out:
                    continue
                protect(HALVES[can_id], data, sent[can_id])
                sent[can_id] += 1
                t_ns += (delays_ns or {}).get(number, 0)
            waiting.append(frame._replace(t_ns=t_ns, data=bytes(data)))
        waiting.sort(key=lambda frame: frame.t_ns)
        yield now, [frame for frame in waiting if frame.t_ns <= now]
        waiting = [frame for frame in waiting if frame.t_ns > now]


def judged(frames):
    """Flags (ticks, N) and the load of drive 1 from when it is known, and what was counted."""
    core = Gateway(parse({"drive": [{"node": node} for node in NODES]}), codec(NODES), 0)
    flags, loads = [], []
    for now, received in frames:
        core.step(received, now)
        flags.append([drive.adhesion for drive in core.view.drives])
        loads.append(core.view.drives[0].load_nm)
    return np.array(flags[FROM:]), np.array(loads[FROM:], dtype=float), core.inbox.counts


@pytest.mark.parametrize(
    "left_out",
    [{1000}, {1000, 1001, 1002}, {1000, 1002}, set(range(1000, 2300, 100))],
    ids=["one", "three", "every second", "one of a hundred"],
)
def test_what_a_sender_leaves_out_without_counting_changes_nothing(left_out):
    flags, load, counts = judged(ticks(left_out))
    assert (flags == Flag.GOOD).all()
    assert np.abs(load - LOAD_NM).max() < 2.0
    assert counts["left_out"] == len(left_out)
    assert counts["lost"] == 0


def later(stall_ns):
    """All samples of a pause at its end, from sample 1000 on."""
    return {1000 + k: stall_ns - k * PERIOD_NS for k in range(stall_ns // PERIOD_NS + 1)}


JITTER = np.random.default_rng(11).integers(0, PERIOD_NS * 9 // 10, 2600).tolist()


@pytest.mark.parametrize(
    "delays_ns",
    [{1000: PERIOD_NS - 1}, later(3 * PERIOD_NS), later(11 * PERIOD_NS // 2), later(7 * PERIOD_NS),
     dict(enumerate(JITTER))],
    ids=["one", "three", "five and a half", "seven", "jitter of 0.9 periods"],
)  # fmt: skip
def test_what_is_only_delayed_is_not_left_out(delays_ns):
    """A sender, a bus or a machine that stood still: the next ones are in time again."""
    flags, load, counts = judged(ticks(delays_ns=delays_ns))
    assert (flags == Flag.GOOD).all()
    assert np.abs(load - LOAD_NM).max() < 2.0
    assert counts["left_out"] == 0


@pytest.mark.parametrize("path", [CLASSIC, FD_FILE], ids=["classic", "fd"])
def test_a_drive_that_speaks_in_bursts_has_plausible_currents(path):
    """As a machine sends that does other things for up to 8 ms."""
    rng, wakes_ns, waiting, sent = np.random.default_rng(5), 0, [], []

    def in_bursts(frames, now):
        nonlocal wakes_ns, waiting, sent
        waiting += frames
        while wakes_ns <= now:
            due = sum(frame.t_ns <= wakes_ns for frame in waiting)
            sent += [f._replace(t_ns=wakes_ns + k * 20_000) for k, f in enumerate(waiting[:due])]
            waiting = waiting[due:]
            wakes_ns += int(rng.integers(2 * MS, 8 * MS))
        come, sent = [f for f in sent if f.t_ns <= now], [f for f in sent if f.t_ns > now]
        return come

    run = scenario(seed=3, duration_s=SECONDS, motion={"profile": [[0.0, 200.0]]})
    flags, _ = flags_and_speeds(run, codec(NODES, path), in_bursts)
    assert (flags[FROM:] == Flag.GOOD).all()


CODEC = codec_for()


def test_a_gap_is_told_by_the_counter_and_not_by_jittering_stamps():
    motor = SteadyDrive(CODEC, 1, 100.0, 20.0)
    box = Inbox(CODEC, (1, 2, 3), 10 * MS, Supervision((1, 2, 3), 300 * MS))
    rng = np.random.default_rng(4)
    sent = [motor.frames(k) for k in range(40)]
    frames = [f for k in range(40) if k not in (10, 11, 20) for f in sent[k]]
    late = [f._replace(t_ns=f.t_ns + int(rng.integers(2 * MS))) for f in frames]
    gaps = []
    for tick in range(1, 12):
        now = tick * 10 * MS
        box.take([f for f in late if now - 10 * MS < f.t_ns <= now], now)
        gaps += box.samples.gap.tolist()
    assert sorted(gaps)[-2:] == [16, 32]
    assert len(gaps) == 37


def test_fd_frames_become_eight_samples_each():
    codec = codec_for((1, 2), FD_FILE)
    sender = Sender(codec, "Drive1_Samples")
    box = Inbox(codec, (1, 2), 10 * MS, Supervision((1, 2), 300 * MS))
    values = {"Udc": 500.0}
    for k in range(8):
        values |= {f"Ia_{k}": k, f"Ib_{k}": -k, f"Ualpha_{k}": 2.0 * k, f"Ubeta_{k}": 0.25}
    for n in (0, 1, 3):
        frame = sender.frame((n + 1) * MS, SampleIndex=8 * n, **values)
        box.take([frame], (n + 1) * MS)
        assert box.samples.drive.tolist() == [0] * 8
        assert box.samples.y[:, 0].tolist() == list(range(8))
        assert box.samples.y[:, 1] == pytest.approx([-k / 3**0.5 for k in range(8)])
        assert box.samples.u[:, 0].tolist() == [2.0 * k for k in range(8)]
        assert box.samples.gap.tolist() == [8 if n == 3 else 0] + [0] * 7


def test_hole_longer_than_the_limit_starts_anew():
    motor = SteadyDrive(CODEC, 1, 100.0, 20.0)
    box = Inbox(CODEC, (1,), 10 * MS, Supervision((1,), 300 * MS))
    box.take(motor.frames(0), 2 * MS)
    assert box.receiver.drives["restart"].tolist() == [1]
    box.take(motor.frames(1), 4 * MS)
    assert not box.receiver.drives["restart"].any()
    assert isinstance(box.drives[0].channels["PhaseCurrents"], Channel)
    far = 1 + MAX_GAP_NS // (2 * MS) + 5
    box.take(motor.frames(far), (far + 1) * 2 * MS)
    assert box.receiver.drives["restart"].tolist() == [1]
