"""The live loop: order within a tick, what it tells the core, and how it ends."""

import gc
import os
import signal

import pytest

from dbc.frame import MS, Frame
from gateway.io.canopen_node import CanopenNode, GatewayError
from gateway.io.live import Stop, run_live, stop_on_signals
from gateway.io.realtime import Ticker
from tests.buses import Bus, Clock

pytestmark = pytest.mark.usefixtures("loaded_frozen")
FLAGS = 0x1A0


class Core:
    """A core that writes down what it is told and sends one flag frame per tick."""

    def __init__(self, journal):
        self.journal = journal
        self.timing = []
        self.decided = None
        self.watching = None
        self.intruder = False
        self.intruder_at = -1
        self.fails_at = -1
        self.ticks = 0

    def step(self, frames, now_ns):
        if self.ticks == self.fails_at:
            raise ZeroDivisionError
        self.ticks += 1
        self.intruder |= self.ticks == self.intruder_at
        if frames.size:
            self.decided = int(frames.t_ns.max())
        self.journal.append(f"step {frames.size}")
        return [Frame(now_ns, FLAGS, b"verdict!")]

    @property
    def decided_ns(self):
        return self.decided

    @property
    def integrity(self):
        return self

    def note_overrun(self, missed):
        self.journal.append(f"overrun {missed}")

    def note_lost(self, frames):
        self.journal.append(f"lost {frames}")

    def note_timing(self, latency_p99_us, lateness_p99_us):
        self.timing.append((latency_p99_us, lateness_p99_us))

    def unknown_frames(self, now_ns):
        return [Frame(now_ns, FLAGS, b"unknown!")]


class Pair(Bus):
    """Gives two frames per tick, and takes its time when told to; `journal` are its calls."""

    def __init__(self, clock, journal):
        super().__init__()
        self.calls = self.journal = journal
        self.stall = {}
        self._clock = clock
        self._reads = 0

    def waiting_frames(self):
        self.journal.append("receive")
        stamp = self._clock.now
        self._clock.now += self.stall.get(self._reads, 0)
        self._reads += 1
        return [Frame(stamp, 0x181, b""), Frame(stamp, 0x182, b"")]

    def send(self, frame):
        self.journal.append(f"send {frame.can_id:03X}")
        return super().send(frame)


class Setup:
    """Everything the loop needs, ending after a number of ticks."""

    def __init__(self, ticks=3):
        self.clock = Clock(5_000 * MS)
        self.journal = []
        self.core = Core(self.journal)
        self.bus = Pair(self.clock, self.journal)
        self.ticker = Ticker(10 * MS, self.clock, self.clock.sleep)
        self.stop = Stop()
        self.snapshots = []
        self._left = ticks

    def on_tick(self, seen):
        self.snapshots.append((seen.tick, seen.missed, len(seen.sent)))
        self._left -= 1
        if self._left == 0:
            self.stop()

    def run(self, errors=()):
        return run_live(
            self.core,
            self.bus,
            CanopenNode(),
            self.ticker,
            stop=self.stop,
            errors=lambda: errors,
            on_tick=self.on_tick,
        )


def test_a_tick_drains_steps_and_sends_and_the_end_says_unknown_three_times():
    setup = Setup(ticks=2)
    setup.run()
    assert setup.journal == [
        *("receive", "step 2", "send 1A0", "send 720", "send 720"),
        *("receive", "step 2", "send 1A0"),
        *["send 1A0"] * 3,
        "close",
    ]
    flags = [f for f in setup.bus.sent if f.can_id == FLAGS]
    assert [f.data for f in flags] == [b"verdict!"] * 2 + [b"unknown!"] * 3
    assert [(f.t_ns - flags[0].t_ns) // MS for f in flags] == [0, 10, 20, 30, 40]


@pytest.mark.parametrize(("stood_ms", "said"), [(20, 1), (21, 0), (2000, 0)])
def test_what_was_decided_before_a_stop_is_not_said_after_it(monkeypatch, stood_ms, said):
    """Stopped between deciding and sending, by SIGSTOP or by other work. Events still leave."""
    setup = Setup(ticks=2)
    step = setup.core.step

    def stopped(frames, now_ns):
        decided = step(frames, now_ns)
        if setup.core.ticks == 1:
            setup.clock.now += stood_ms * MS
        return decided

    monkeypatch.setattr(setup.core, "step", stopped)
    seen = setup.run()
    verdicts = [f for f in setup.bus.sent if f.data == b"verdict!"]
    assert len(verdicts) == 1 + said
    assert seen.status.tx_late == 1 - said
    assert next(f.data for f in setup.bus.sent if f.can_id == 0x720) == b"\x00"


def test_missed_ticks_are_told_before_the_step():
    setup = Setup(ticks=3)
    setup.bus.stall = {0: 47 * MS}
    seen = setup.run()
    told = setup.journal.index("overrun 3")
    assert setup.journal[told : told + 3] == ["overrun 3", "receive", "step 2"]
    assert setup.snapshots == [(0, 0, 3), (4, 3, 1), (5, 3, 1)]
    assert seen.missed == 3
    stages = {stage.name: stage.largest for stage in seen.timing.stage_rows()}
    assert stages["reading"] == stages["frame to flag"] == 47 * MS
    assert stages["waiting"] == stages["deciding"] == stages["sending"] == 0


def test_frames_that_nobody_read_in_time_are_told_before_the_step():
    setup = Setup(ticks=3)
    setup.bus.status.kernel_drops = 100  # of a time before this loop
    read = setup.bus.receive

    def receive():
        setup.bus.status.kernel_drops += 7 if setup.core.ticks == 1 else 0
        return read()

    setup.bus.receive = receive
    setup.run()
    told = [line for line in setup.journal if line.startswith(("step", "lost"))]
    assert told == ["step 2", "lost 7", "step 2", "step 2"]


def test_an_intruder_is_said_once(caplog):
    setup = Setup(ticks=5)
    setup.core.intruder_at = 2
    setup.run()
    said = [record.message for record in caplog.records if "on_intruder" in record.message]
    assert len(said) == 1


@pytest.mark.parametrize("echo", [False, True])
@pytest.mark.parametrize("silent", [False, True])
def test_intruders_are_looked_for_by_who_sends_and_does_not_hear_itself(echo, silent):
    setup = Setup()
    setup.bus.status.hears_itself = echo
    setup.bus.status.silent = silent
    setup.run()
    assert setup.core.watching is not (echo or silent)


def test_timing_is_told_once_a_second():
    setup = Setup(ticks=301)
    setup.bus.stall = dict.fromkeys(range(150, 190), 3 * MS)
    setup.run()
    assert setup.core.timing == [(0, 0), (3000, 0), (3000, 0)]


def test_errors_become_emergencies():
    setup = Setup()
    setup.run(errors=(GatewayError.OVERRUN,))
    assert [f.data[:3] for f in setup.bus.sent if f.can_id == 0x0A0] == [b"\x00\x61\x01"]


def test_a_fault_of_the_program_still_takes_the_flags_back():
    setup = Setup(ticks=10)
    setup.core.fails_at = 2
    with pytest.raises(ZeroDivisionError):
        setup.run()
    assert setup.journal[-1] == "close"
    assert [f.data for f in setup.bus.sent[-3:]] == [b"unknown!"] * 3


def test_the_garbage_collector_is_given_back():
    before = gc.get_freeze_count()
    seen = []
    setup = Setup()
    on_tick = setup.on_tick

    def look(snapshot):
        seen.append(gc.get_freeze_count())
        on_tick(snapshot)

    setup.on_tick = look
    setup.run()
    assert min(seen) > before
    assert gc.get_freeze_count() == 0
    assert gc.isenabled()


def test_sigterm_ends_the_loop_and_the_handlers_are_put_back():
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGTERM, signal.SIGINT)}
    setup = Setup(ticks=-1)

    def terminate(snapshot):
        if snapshot.tick == 4:
            os.kill(os.getpid(), signal.SIGTERM)

    setup.on_tick = terminate
    setup.run()
    assert setup.stop.requested
    assert [f.data for f in setup.bus.sent[-3:]] == [b"unknown!"] * 3
    assert {kind: signal.getsignal(kind) for kind in before} == before


def test_a_second_signal_acts_as_before():
    # A shell that starts the tests in the background has them ignore SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    stop = Stop()
    try:
        with stop_on_signals(stop):
            os.kill(os.getpid(), signal.SIGINT)
            assert stop.requested
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
