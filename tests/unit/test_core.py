"""The core on frames of exact steady motors: what it says, and what it refuses to say."""

import itertools

import numpy as np
import pytest

from dbc.frame import ERROR, EXTENDED, REMOTE, Frame
from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import Config
from gateway.settings.sections import Drive
from tests.sender import MS, Sender, SteadyDrive, codec_for

CODEC = codec_for()
TICK = 10 * MS


def gateway(nodes=(1, 2, 3), **sections):
    config = Config(drive=tuple(Drive(node=n) for n in nodes), **sections)
    return Gateway(config, codec_for(nodes), 0)


def drives(loads=(20.0, 20.0, 20.0), w=100.0):
    return [SteadyDrive(CODEC, n + 1, w, load, theta=0.4 * n - 2.0) for n, load in enumerate(loads)]


class Bench:
    """Feeds a gateway tick by tick; `touch` may change the frames of a tick."""

    def __init__(self, core, motors):
        self.core, self.motors = core, motors
        self.tick = 0
        self.sent = []

    def run(self, ticks, touch=lambda frames, now: frames):
        for _ in range(ticks):
            self.tick += 1
            now = self.tick * TICK
            frames = []
            for k in range(5 * (self.tick - 1), 5 * self.tick):
                for motor in self.motors:
                    frames += motor.frames(k)
            self.sent = self.core.step(touch(frames, now), now)
        return self.core.view

    @property
    def view(self):
        return self.core.view


def named(frames):
    """Frames by message name, signals as raw numbers."""
    out = {}
    for frame in frames:
        spec = CODEC.by_id[frame.can_id]
        out[spec.name] = {n: r.raw for n, r in CODEC.decode(spec, frame.data).items()}
    return out


def test_unknown_until_known_then_adhering_with_the_right_load():
    bench = Bench(gateway(), drives())
    view = bench.run(4)
    assert [d.adhesion for d in view.drives] == [Flag.UNKNOWN] * 3
    assert view.adhesion_reason is Reason.STARTING
    view = bench.run(40)
    assert [d.adhesion for d in view.drives] == [Flag.GOOD] * 3
    assert [d.health for d in view.drives] == [Health.TRACKING] * 3
    assert [d.load_nm for d in view.drives] == pytest.approx([20.0] * 3, abs=0.6)
    assert [d.speed_rad_s for d in view.drives] == pytest.approx([25.0] * 3, abs=0.3)
    assert view.adhesion_reason is Reason.NONE
    assert view.comm is Flag.GOOD


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("detector", ["vb", "median"])
def test_a_drive_that_carries_less_is_lost(kind, detector):
    core = gateway(estimator={"kind": kind}, adhesion={"detector": detector})
    view = Bench(core, drives((20.0, 8.0, 20.0))).run(60)
    assert [d.adhesion for d in view.drives] == [Flag.GOOD, Flag.BAD, Flag.GOOD]
    assert view.drives[1].loss_probability > 0.9


@pytest.mark.parametrize("observe", ["torque", "speed", "both"])
def test_the_papers_vb_sees_what_it_is_told_to_observe(observe):
    core = gateway(adhesion={"detector": "paper_vb", "observe": observe})
    view = Bench(core, drives((20.0, 0.5, 20.0))).run(60)
    lost = [float(d.loss_probability) for d in view.drives]
    assert all(d.health is Health.TRACKING for d in view.drives)
    assert core.adhesion.detector.observe.value == observe
    # The three turn at one speed: the wheel that carries nothing is seen by its torque alone.
    assert lost[1] > 0.9
    assert (lost[0] < 0.5) == (lost[2] < 0.5)


def test_a_drive_cut_by_command_is_not_lost():
    motors = drives((20.0, 6.0, 20.0))
    motors[1].command = 6.0
    view = Bench(gateway(), motors).run(80)
    assert [d.adhesion for d in view.drives] == [Flag.GOOD] * 3


@pytest.mark.parametrize(("command", "flag"), [(20.0, Flag.GOOD), (30.0, Flag.BAD)])
def test_one_drive_alone_is_judged_by_its_command(command, flag):
    motors = drives((20.0,))
    motors[0].command = command
    view = Bench(gateway(nodes=(1,)), motors).run(60)
    assert view.drives[0].adhesion is view.common_mode is flag


def test_one_drive_alone_without_a_command_cannot_be_judged():
    status = CODEC.by_name["Drive1_Status"].can_id
    view = Bench(gateway(nodes=(1,)), drives((20.0,))).run(
        60, lambda frames, now: [f for f in frames if f.can_id != status]
    )
    assert view.drives[0].adhesion is view.common_mode is Flag.UNKNOWN
    assert view.drives[0].adhesion_reason is Reason.TOO_FEW_DRIVES


def test_silence_is_stale_within_three_periods_and_a_tick():
    bench = Bench(gateway(), drives())
    bench.run(60)
    silent = lambda frames, now: [f for f in frames if (f.can_id & 0x7F) % 16 != 2]  # noqa: E731
    view = bench.run(1, silent)
    assert view.drives[1].adhesion is Flag.GOOD  # 10 ms old: within 3 * 2 ms + 10 ms
    view = bench.run(1, silent)
    assert view.drives[1].adhesion is Flag.UNKNOWN
    assert view.adhesion_reason is Reason.STALE
    assert view.comm is Flag.BAD
    assert [d.adhesion for d in view.drives][::2] == [Flag.GOOD] * 2


def corrupt(frame):
    return frame._replace(data=bytes([frame.data[0] ^ 0x5A]) + frame.data[1:])


@pytest.mark.parametrize(
    ("touch", "reason", "counter"),
    [
        (corrupt, Reason.CORRUPTED, "error"),
        (lambda f: f._replace(data=f.data[:-1]), Reason.CORRUPTED, "wrong_length"),
        (lambda f: f._replace(flags=8), Reason.CORRUPTED, "wrong_length"),
        (lambda f: f._replace(flags=REMOTE, data=b""), Reason.STALE, "remote"),
        (lambda f: f._replace(flags=ERROR), Reason.STALE, "error_frame"),
        (lambda f: f._replace(flags=EXTENDED), Reason.STALE, "unknown_id"),
    ],
)
def test_bad_frames_of_one_drive_are_counted_and_make_it_unknown(touch, reason, counter):
    bench = Bench(gateway(), drives())
    bench.run(60)
    mine = CODEC.by_name["Drive2_PhaseCurrents"].can_id
    view = bench.run(4, lambda frames, now: [touch(f) if f.can_id == mine else f for f in frames])
    assert view.drives[1].adhesion is Flag.UNKNOWN
    assert view.drives[1].adhesion_reason is reason
    assert [d.adhesion for d in view.drives][::2] == [Flag.GOOD] * 2
    assert bench.core.inbox.counts[counter] == 20


def instead(bench, **values):
    """What the second drive says of its currents, with the counters of what it would say."""
    mine = bench.motors[1].currents

    def touch(frames, now):
        mine.counter -= 5
        bad = [mine.frame(f.t_ns, **values) for f in frames if f.can_id == mine.spec.can_id]
        return [f for f in frames if f.can_id != mine.spec.can_id] + bad

    return touch


@pytest.mark.parametrize(
    ("values", "reason", "counter"),
    [
        ({"Ia": None}, Reason.NOT_AVAILABLE, "not_available"),
        ({"Ia": 5000.0}, Reason.RANGE, "range"),
        ({"Quality": None}, Reason.NOT_AVAILABLE, "not_available"),
        ({"Quality": 0}, Reason.NOT_AVAILABLE, "not_available"),
    ],
)
def test_not_available_and_saturated_values_make_unknown_at_once(values, reason, counter):
    bench = Bench(gateway(), drives())
    bench.run(60)
    view = bench.run(1, instead(bench, **{"Ia": 0.0, "Ib": 0.0, "Ic": 0.0, **values}))
    assert view.drives[1].adhesion is Flag.UNKNOWN
    assert view.drives[1].adhesion_reason is reason
    assert view.drives[1].health is Health.INPUT_INVALID
    assert bench.core.inbox.counts[counter] == 5


def test_repeated_counters_are_a_sequence_fault_and_never_used_twice():
    bench = Bench(gateway(), drives())
    bench.run(60)
    mine = CODEC.by_name["Drive2_PhaseCurrents"].can_id
    kept = {}

    def stuck(frames, now):
        for f in frames:
            if f.can_id == mine:
                kept.setdefault("frame", f)
        return [kept["frame"]._replace(t_ns=f.t_ns) if f.can_id == mine else f for f in frames]

    view = bench.run(3, stuck)
    assert view.drives[1].adhesion_reason is Reason.SEQUENCE
    assert bench.core.inbox.counts["repeated"] == 14


def test_currents_that_do_not_add_up_are_contradictory():
    bench = Bench(gateway(), drives())
    bench.run(60)
    view = bench.run(5, instead(bench, Ia=20.0, Ib=20.0, Ic=20.0))
    assert view.drives[1].adhesion_reason is Reason.RANGE
    assert view.sensor is Flag.BAD


def test_a_heartbeat_that_was_seen_and_stops_is_a_communication_fault():
    bench = Bench(gateway(), drives())

    def beat(frames, now):
        return [*frames, Frame(now, 0x701, b"\x05")] if now % (100 * MS) == 0 else frames

    assert bench.run(60, beat).comm is Flag.GOOD
    assert bench.run(29).comm is Flag.GOOD
    view = bench.run(3)
    assert view.comm is Flag.BAD
    assert view.drives[0].adhesion is Flag.UNKNOWN
    assert view.drives[1].adhesion is Flag.GOOD


def test_a_message_that_was_heard_and_never_valid_is_not_known_to_be_good():
    motion = Sender(CODEC, "Drive1_Motion")
    bench = Bench(gateway(), drives())
    bench.run(60)
    assert bench.view.comm is Flag.GOOD

    def once(frames, now):
        return [*frames, motion.frame(now, Speed=955.0)]

    bench.run(1, once)
    assert bench.run(60).comm is Flag.UNKNOWN
    bench.run(1, once)
    assert bench.run(5).comm is Flag.UNKNOWN, "the one of long ago says nothing of this one"
    bench.run(1, once)
    assert bench.run(1).comm is Flag.UNKNOWN, "another may follow within a slowest cycle"


@pytest.mark.parametrize("phase", range(10))
def test_messages_that_begin_one_after_another_do_not_make_the_bus_flag_flicker(phase):
    late = Sender(CODEC, "Drive1_Temperatures")
    slow = {m.can_id for m in CODEC.messages if m.kind in ("Status", "Temperatures")}

    def touch(frames, now):
        others = [f for f in frames if f.can_id not in slow]
        return [*others, late.frame(now)] if now // TICK % 10 == phase else others

    bench = Bench(gateway(), drives())
    said = [bench.run(1, touch).comm for _ in range(60)]
    assert [flag for flag, _ in itertools.groupby(said)] == [Flag.UNKNOWN, Flag.GOOD]


def test_a_pair_is_as_stale_as_its_older_frame():
    """CommonMode and Health would, else, outlive the flags by a tick."""

    def early_currents(frames, now):
        return [
            f._replace(t_ns=f.t_ns - MS) if 0x181 <= f.can_id <= 0x183 else f
            for f in frames
        ]  # fmt: skip

    said = set()
    for later in range(13 * MS, 20 * MS, MS // 2):
        bench = Bench(gateway(), drives())
        bench.run(60, early_currents)
        bench.core.step([], bench.tick * TICK + later)
        view = bench.view
        good = [d.adhesion is Flag.GOOD for d in view.drives]
        said.add(tuple(good))
        assert [d.health is Health.TRACKING for d in view.drives] == good, later
        assert (view.common_mode is Flag.GOOD) is any(good), later
    assert said == {(True,) * 3, (False,) * 3}


def test_farewell_says_unknown():
    bench = Bench(gateway(), drives((20.0, 8.0, 20.0)))
    bench.run(60)
    frames = named(bench.core.unknown_frames(61 * TICK))
    assert [frames["Gateway_Adhesion"][f"Adhesion{n}"] for n in range(1, 17)] == [0] * 16
    assert frames["Gateway_Status"]["State"] == 4


def test_standstill_is_unknown_not_good():
    motors = drives((0.0, 0.0, 0.0), w=0.001)
    view = Bench(gateway(), motors).run(100)
    assert [d.adhesion for d in view.drives] == [Flag.UNKNOWN] * 3


@pytest.mark.parametrize(("rpm", "flag"), [(25.0 * 30 / np.pi, Flag.GOOD), (-238.7, Flag.UNKNOWN)])
def test_measured_speed_that_contradicts_makes_unknown(rpm, flag):
    bench = Bench(gateway(), drives())
    motion = Sender(CODEC, "Drive1_Motion")

    def measured(frames, now):
        return [*frames, motion.frame(now, Speed=rpm, ElectricalAngle=10.0, Torque=20.0)]

    view = bench.run(60, measured)
    assert view.drives[0].adhesion is flag
    assert view.drives[1].adhesion is Flag.GOOD
    if flag is Flag.UNKNOWN:
        assert view.adhesion_reason is Reason.RANGE
        assert view.drives[0].health is Health.INPUT_INVALID


def test_commands_that_ramp_with_the_train_accuse_nobody():
    """Status frames of the drives are a third of a cycle apart while all commands rise alike."""
    motors = drives((6.0, 6.0, 6.0))
    for motor in motors:
        motor.command = 2.5
    bench = Bench(gateway(), motors)
    bench.run(60)
    seen = set()
    for step in range(9):
        motors[step % 3].command = 2.5 + 0.5 * step
        view = bench.run(3)
        seen |= {d.adhesion for d in view.drives}
    assert seen == {Flag.GOOD}


def test_input_that_is_bad_from_the_start_says_so():
    bench = Bench(gateway(), drives())
    mine = CODEC.by_name["Drive2_PhaseCurrents"].can_id
    view = bench.run(
        20, lambda frames, now: [corrupt(f) if f.can_id == mine else f for f in frames]
    )
    assert view.drives[1].adhesion_reason is Reason.CORRUPTED
