"""What the service manager is told: the real core on a bus that fails on demand, a real socket."""

import os
import select
import signal
import socket
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from dbc.codec import bind
from dbc.frame import MS, SECOND
from dbc.frames import EMPTY
from gateway.core.gateway import Gateway
from gateway.core.supervision import HEARTBEAT_ID
from gateway.io.canopen_node import CanopenNode
from gateway.io.live import Stop, run_live
from gateway.io.outputs import MOST_LATE, Outputs
from gateway.io.realtime import Ticker
from gateway.io.service import FEEDS, Manager, Overseer
from gateway.io.transport import LinkState, SendResult, Status
from gateway.io.wire import BusState
from gateway.settings.config import parse
from tests.programs import await_state

pytestmark = pytest.mark.usefixtures("loaded_frozen")
WATCHDOG_NS = SECOND
ADHESION, STATUS = 0x1A0, 0x4A0


class Listener:
    """The service manager's end of the socket."""

    def __init__(self, name):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + name[1:] if name[0] == "@" else name)

    def heard(self, wait_s=0.0):
        """Everything that waits; waits for the first."""
        found = []
        while select.select([self.socket], [], [], 0.0 if found else wait_s)[0]:
            found.append(self.socket.recv(4096).decode())
        return found


@pytest.fixture
def listener(tmp_path, monkeypatch):
    listener = Listener(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", str(WATCHDOG_NS // 1000))
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    yield listener
    listener.socket.close()


class Rig:
    """The core, a bus and a virtual clock; `at` has what happens before which tick."""

    def __init__(self, listener):
        self.listener = listener
        self.now = 5 * SECOND
        self.status = Status(state=LinkState.UP)
        self.result = SendResult.SENT
        self.change = lambda frames: frames
        self.slow = lambda tick: False
        self.at = {}
        self.told = []
        self.sent = []
        config = parse({"bus": {"on_intruder": "stop"}})
        self.core = Gateway(config, bind(config.dbc_path, config.nodes), self.now)
        self.node = CanopenNode(config.nodes)
        self._tick = 0

    # What the loop wants of a core, a transport and a clock.

    def step(self, frames, now_ns):
        out = self.change(self.core.step(frames, now_ns))
        if self.slow(self._tick):
            self.now += 30 * MS
        return out

    def __getattr__(self, name):
        return getattr(self.core, name)

    def receive(self):
        return EMPTY

    def send(self, frame):
        self.sent.append(frame)
        return self.status.count(self.result)

    def close(self): ...

    def sleep(self, seconds):
        self.now += round(seconds * SECOND)

    def run(self, ticks):
        """(tick, line) of everything that the service manager heard."""
        stop = Stop()
        outputs = Outputs(self.core.outbox.specs.values(), lambda: self.core.silent)
        overseer = Overseer(outputs, Manager.from_environment(), "can7", 4 * SECOND)

        def on_tick(seen):
            overseer.completed(seen)
            self.told += [(seen.tick, s) for m in self.listener.heard() for s in m.splitlines()]
            self._tick = seen.tick + 1
            self.at.get(self._tick, lambda: None)()
            if self._tick >= ticks:
                stop()

        self.at.get(0, lambda: None)()
        ticker = Ticker(10 * MS, lambda: self.now, self.sleep)
        try:
            run_live(self, self, self.node, ticker, stop=stop, on_tick=on_tick,
                     on_end=overseer.stopping)  # fmt: skip
        finally:
            for message in self.listener.heard():
                self.told += [(self._tick, line) for line in message.splitlines()]
        return self.told

    def ticks_of(self, line):
        return [tick for tick, said in self.told if said == line]


@pytest.fixture
def rig(listener):
    return Rig(listener)


def test_ready_after_the_first_tick_fed_four_times_in_its_time_and_stopping_once(rig):
    rig.run(301)
    assert rig.told[:3] == [(0, "READY=1"), (0, "STATUS=runs on can7"), (0, "WATCHDOG=1")]
    assert rig.ticks_of("READY=1") == [0]
    fed = rig.ticks_of("WATCHDOG=1")
    assert fed == list(range(0, 301, 100 // FEEDS))
    assert [said for tick, said in rig.told if tick == 301] == [
        "STOPPING=1", "STATUS=sends Unknown flags and stops",
    ]  # fmt: skip


def nothing(_):
    return []


def without(can_id):
    return lambda frames: [f for f in frames if f.can_id != can_id]


def flipped(frames):
    return [f._replace(data=bytes((f.data[0], f.data[1], f.data[2] ^ 1, *f.data[3:])))
            for f in frames]  # fmt: skip


class Repeated:
    """The same frame again and again, as a caching bug would send it."""

    def __init__(self):
        self.first = {}

    def __call__(self, frames):
        return [self.first.setdefault(f.can_id, f) for f in frames]


FAULTS = {
    "no frames": nothing, "no flags": without(ADHESION), "no status": without(STATUS),
    "wrong checksum": flipped, "repeated": Repeated(),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_loop_that_sends_no_good_frames_is_not_kept_alive(rig, fault, caplog):
    rig.at[100] = lambda: setattr(rig, "change", FAULTS[fault])
    rig.run(400)
    fed = rig.ticks_of("WATCHDOG=1")
    # Status is due every tenth tick only: between them a tick without it is in order.
    assert 75 in fed
    if fault == "no status":
        assert max(fed) < 120
    else:
        assert max(fed) <= 100
    assert any("STATUS=faulty output" in said for _, said in rig.told)
    assert "watchdog not fed in this tick" in caplog.text


def test_frames_that_are_due_again_feed_it_again(rig):
    rig.at[100] = lambda: setattr(rig, "change", nothing)
    rig.at[150] = lambda: setattr(rig, "change", lambda frames: frames)
    rig.run(400)
    fed = rig.ticks_of("WATCHDOG=1")
    assert not [tick for tick in fed if 100 < tick < 150]
    # The counters went on while nothing left, so each message costs one tick at its return; those
    # that were never late have gone on.
    assert [tick for tick in fed if tick > 260]


@pytest.mark.parametrize("result", [SendResult.FAILED, SendResult.REFUSED])
def test_frames_that_nobody_takes_make_nobody_ready(rig, result):
    rig.result = result
    rig.run(50)
    assert not rig.ticks_of("READY=1")
    assert not rig.ticks_of("WATCHDOG=1")


def test_a_bus_that_is_not_there_is_a_state_of_a_service_that_runs(rig):
    rig.status.state, rig.status.note = LinkState.ABSENT, "can7 is not there: No such device"
    rig.result = SendResult.DOWN

    def comes():
        rig.status.state, rig.status.note, rig.result = LinkState.UP, "", SendResult.SENT

    rig.at[200] = comes
    rig.at[300] = lambda: setattr(rig.status, "bus_state", BusState.BUS_OFF)
    rig.run(400)
    assert rig.ticks_of("READY=1") == [0]
    assert rig.ticks_of("WATCHDOG=1") == list(range(0, 400, 25))
    said = [line for _, line in rig.told if line.startswith("STATUS=")]
    assert said[:3] == [
        "STATUS=waits: can7 is not there: No such device", "STATUS=runs on can7",
        "STATUS=waits: can7 is bus-off",
    ]  # fmt: skip


def test_a_full_queue_is_said_and_survived(rig, caplog):
    rig.result = SendResult.FULL
    rig.run(50)
    assert rig.ticks_of("WATCHDOG=1") == [0, 25]
    assert "transmit queue is full" in caplog.text


def test_a_loop_that_decides_too_late_is_not_kept_alive(rig, caplog):
    """The loop runs and its heartbeat goes, but not one flag leaves."""
    rig.at[100] = lambda: setattr(rig, "slow", lambda _: True)
    rig.run(500)
    left = [f.can_id for f in rig.sent if f.t_ns > 5 * SECOND + 1000 * MS]
    # What is sent at the end is the goodbye.
    assert HEARTBEAT_ID in left
    assert left.count(ADHESION) == 3
    assert rig.status.tx_late > 300
    fed = rig.ticks_of("WATCHDOG=1")
    assert 75 in fed
    assert max(fed) <= 100 + 4 * MOST_LATE
    assert any("1A0 is generated, but too late to be sent" in said for _, said in rig.told)
    assert "watchdog not fed in this tick" in caplog.text


@pytest.mark.parametrize("slow", ["one", "every second", "half"])
def test_late_ticks_now_and_then_are_harmless(rig, slow, caplog):
    """One, all that bring what goes out once a second, even half of them: flags still leave."""
    rig.slow = {
        "one": lambda tick: tick == 142, "every second": lambda tick: tick > 0 and tick % 100 == 0,
        "half": lambda tick: tick > 100 and tick // 4 % 2 == 0,
    }[slow]  # fmt: skip
    rig.run(500)
    assert rig.status.tx_late > 0
    fed = rig.ticks_of("WATCHDOG=1")
    assert max(later - tick for tick, later in pairwise(fed)) < 40
    assert max(fed) > 460
    if slow != "half":
        assert "watchdog not fed in this tick" not in caplog.text


def test_a_start_is_not_ready_before_its_frames_leave(rig):
    rig.slow = lambda tick: tick < 50
    rig.run(300)
    ready = rig.ticks_of("READY=1")
    assert len(ready) == 1
    assert ready[0] >= 50


@pytest.mark.parametrize("result", [SendResult.DOWN, SendResult.FULL])
def test_a_bus_that_takes_nothing_restarts_nobody(rig, result):
    """Nor does it where a tick was late before, or is in between."""
    rig.at[100] = lambda: setattr(rig, "result", result)
    rig.slow = lambda tick: tick in (98, 99, 150)
    rig.run(500)
    fed = rig.ticks_of("WATCHDOG=1")
    assert max(fed) > 460
    assert max(later - tick for tick, later in pairwise(fed)) < 40


def test_silence_on_purpose_is_fed_as_long_as_the_heartbeat_goes(rig):
    def intrude():
        rig.core.integrity.record["intruder"] = 1

    rig.at[100] = intrude
    rig.run(300)
    assert rig.ticks_of("WATCHDOG=1") == list(range(0, 300, 25))
    assert {f.can_id for f in rig.sent if f.t_ns > 5 * SECOND + 1020 * MS} == {HEARTBEAT_ID}
    assert any("another node sends" in said for _, said in rig.told)


def test_a_fault_of_the_program_says_stopping(rig):
    def fail(_):
        raise ZeroDivisionError

    rig.at[10] = lambda: setattr(rig, "change", fail)
    with pytest.raises(ZeroDivisionError):
        rig.run(20)
    assert rig.ticks_of("STOPPING=1") == [10]


def test_a_flapping_link_is_a_line_of_status_a_second(rig):
    for tick in range(1, 1000):
        state = LinkState.DOWN if tick % 2 else LinkState.UP
        rig.at[tick] = lambda state=state: setattr(rig.status, "state", state)
    rig.run(1000)
    assert len([said for _, said in rig.told if said.startswith("STATUS=")]) <= 12


def test_a_full_socket_never_blocks_and_ready_comes_through_later(rig):
    manager = Manager.from_environment()
    taken = 0
    while manager.say("STATUS=fills the queue"):
        taken += 1
    assert 0 < taken < 10_000
    # The rig's listener reads after every tick only, so nothing was taken in the first one.
    rig.run(3)
    assert rig.ticks_of("READY=1") == [1]
    assert rig.ticks_of("WATCHDOG=1") == [1]


def test_the_manager_may_have_made_its_socket_again(listener, tmp_path, caplog):
    manager = Manager.from_environment()
    assert manager.say("STATUS=Zug fährt")
    assert listener.heard() == ["STATUS=Zug fährt"]
    listener.socket.close()
    (tmp_path / "notify").unlink()
    assert not manager.say("WATCHDOG=1")
    assert "cannot be notified" in caplog.text
    assert not manager.say("WATCHDOG=1")
    again = Listener(str(tmp_path / "notify"))
    assert manager.say("WATCHDOG=1")
    assert again.heard() == ["WATCHDOG=1"]
    again.socket.close()


def test_an_abstract_socket(monkeypatch):
    name = f"@traction-gateway-test-{os.getpid()}"
    listener = Listener(name)
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    assert Manager.from_environment().say("READY=1")
    assert listener.heard() == ["READY=1"]
    listener.socket.close()


def test_without_a_manager_nothing_is_opened(monkeypatch):
    def refuse(*_):
        raise AssertionError

    monkeypatch.setattr(socket, "socket", refuse)
    assert Manager.from_environment({}).say("READY=1")
    with pytest.raises(AssertionError):
        Manager.from_environment({"NOTIFY_SOCKET": "/nowhere"}).say("READY=1")


@pytest.mark.parametrize(
    ("given", "watchdog_ns"),
    [
        ({}, 0),
        ({"WATCHDOG_USEC": "500000"}, SECOND // 2),
        ({"WATCHDOG_USEC": "500000", "WATCHDOG_PID": "1"}, 0),
        ({"WATCHDOG_USEC": "500000", "WATCHDOG_PID": str(os.getpid())}, SECOND // 2),
        ({"WATCHDOG_USEC": "soon"}, 0),
        ({"WATCHDOG_USEC": "-5"}, 0),
        ({"WATCHDOG_USEC": "²"}, 0),
    ],
)
def test_the_watchdog_is_for_the_process_that_it_names(given, watchdog_ns):
    assert Manager.from_environment(given).watchdog_ns == watchdog_ns


# A process of its own.

HANGS = """
import sys, time
from gateway.core.gateway import Gateway
step, began = Gateway.step, []
def hang(self, frames, now):
    began or began.append(now)
    if now - began[0] > 1_000_000_000:
        print("hangs", file=sys.stderr, flush=True)
        while True:
            pass
    return step(self, frames, now)
from gateway.cli import main
import gateway.io.live as live
run = live.run_live
def run_live(*given, **more):
    Gateway.step = hang  # not in the warm-up, whose clock is made up
    return run(*given, **more)
live.run_live = run_live
sys.exit(main(sys.argv[1:]))
"""
PATIENCE_S = 120.0


def start(*program, more=()):
    words = ("run", "--quiet", "-i", "virtual", "-c", "service", *more)
    return subprocess.Popen(
        [sys.executable, *program, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def until(listener, line, times=1):
    """Wait until a line was heard so often."""
    deadline = time.monotonic() + PATIENCE_S
    while times > 0:
        assert time.monotonic() < deadline, f"{line}: not within {PATIENCE_S} s"
        times -= sum(line in message.splitlines() for message in listener.heard(1.0))


def test_a_stopped_process_is_silent_and_an_ended_one_says_so(listener):
    process = start("-m", "gateway")
    try:
        until(listener, "READY=1")
        until(listener, "WATCHDOG=1", 3)
        process.send_signal(signal.SIGSTOP)
        await_state(process.pid, "T")
        listener.heard()
        assert listener.heard(1.0) == []
        process.send_signal(signal.SIGCONT)
        until(listener, "WATCHDOG=1", 3)
        process.send_signal(signal.SIGTERM)
        until(listener, "STOPPING=1")
        _, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, errors.decode()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.skipif(
    os.geteuid() != 0, reason="only root has a priority and no limit of locked memory"
)
def test_the_locked_memory_is_bounded(listener):
    process = start("-m", "gateway", more=("--realtime", "10"))
    try:
        until(listener, "WATCHDOG=1", 3)
        lines = Path(f"/proc/{process.pid}/smaps_rollup").read_text("ascii").splitlines()
        (locked,) = (int(line.split()[1]) for line in lines if line.startswith("Locked:"))
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, errors.decode()
    finally:
        process.kill()
        process.communicate()
    assert 0 < locked <= 60_000, "kB"


def test_a_tick_that_never_ends_lets_the_watchdog_starve(listener):
    process = start("-c", HANGS)
    try:
        until(listener, "READY=1")
        until(listener, "WATCHDOG=1")
        assert any(line == b"hangs\n" for line in process.stderr)
        listener.heard()
        assert listener.heard(0.8) == []
        assert process.poll() is None
        # Nor does it end by itself when told to once: that is what SIGKILL and SIGABRT are for.
        process.send_signal(signal.SIGTERM)
        assert listener.heard(0.5) == []
        assert process.poll() is None
    finally:
        process.kill()
        process.communicate()
