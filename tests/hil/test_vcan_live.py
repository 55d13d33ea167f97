"""The `run` command as a process of its own on a real bus: hanging, ending, links, NMT."""

import signal
import subprocess
import sys
import time

import pytest

from dbc.codec import bind
from dbc.frame import MS, Frame
from gateway.io.socketcan import SocketCan
from gateway.io.transport import SendResult
from gateway.settings.config import shipped_dbc
from tests.buses import frames_of

pytestmark = pytest.mark.vcan

PATIENCE_S = 60.0
"""Loading the program takes seconds in user-mode-linux."""
ADHESION, STATUS, HEARTBEAT, EMERGENCY, NMT = 0x1A0, 0x4A0, 0x720, 0x0A0, 0x000


class Watcher:
    """Everything heard on the bus so far."""

    def __init__(self, name):
        self.bus = SocketCan(name)
        self.bus.open()
        self.frames = []

    def of(self, can_id, after_ns=0):
        self.frames += frames_of(self.bus)
        return [f for f in self.frames if f.can_id == can_id and f.t_ns > after_ns]

    def until(self, fulfilled):
        deadline = time.monotonic() + PATIENCE_S
        while not fulfilled():
            assert time.monotonic() < deadline, f"not within {PATIENCE_S} s"
            time.sleep(0.01)
            self.frames += frames_of(self.bus)


@pytest.fixture
def watcher(vcan):
    watcher = Watcher(vcan.name)
    yield watcher
    watcher.bus.close()


def run(vcan, *more):
    command = [sys.executable, "-m", "gateway", "run", "-i", "socketcan", "-c", vcan.name]
    return vcan.start(*command, "--quiet", *more, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_a_hung_gateway_is_silent_and_an_ended_one_says_unknown(vcan, watcher):
    process = run(vcan)
    watcher.until(lambda: len(watcher.of(ADHESION)) > 50)
    assert watcher.of(HEARTBEAT)[0].data == b"\x00"
    assert watcher.of(HEARTBEAT)[-1].data == b"\x05"
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)  # whatever was on its way has arrived
    stopped = time.monotonic_ns()
    time.sleep(1.0)
    assert watcher.of(ADHESION, stopped) == []
    assert watcher.of(HEARTBEAT, stopped) == []
    process.send_signal(signal.SIGCONT)
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))

    def says_how_many_ticks_it_missed():
        # Not the first status: the signal may have come in the middle of a tick.
        statuses = [codec.decode(codec.by_id[STATUS], f.data) for f in watcher.of(STATUS, stopped)]
        return any(status["DeadlineMisses"].value >= 100 for status in statuses)

    watcher.until(says_how_many_ticks_it_missed)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    assert b"ticks missed" in output
    last = [codec.decode(codec.by_id[ADHESION], f.data) for f in watcher.of(ADHESION)[-3:]]
    assert {reading[f"Adhesion{n}"].raw for reading in last for n in (1, 2, 3)} == {0}
    final = codec.decode(codec.by_id[STATUS], watcher.of(STATUS)[-1].data)
    assert codec.by_id[STATUS].signals[2].labels[int(final["State"].raw)] == "Silent"


def test_a_second_sender_of_our_identifiers_silences_a_gateway_that_shall_stop(
    vcan, watcher, tmp_path
):
    config = tmp_path / "stop.toml"
    config.write_text('[bus]\non_intruder = "stop"\n')
    process = run(vcan, "--config", str(config))
    watcher.until(lambda: len(watcher.of(ADHESION)) > 50)
    vcan.send("1A0#0000000000000000")
    watcher.until(lambda: any(f.data[:2] == b"\x50\x81" for f in watcher.of(EMERGENCY)))
    time.sleep(0.3)  # whatever was on its way has arrived
    found = time.monotonic_ns()
    time.sleep(1.0)
    assert watcher.of(ADHESION, found) == []
    assert len(watcher.of(HEARTBEAT, found)) > 5
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))
    ours = codec.decode(codec.by_id[ADHESION], watcher.of(ADHESION)[-1].data)
    assert ours["Reason"].raw == 10
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    assert b"on_intruder" in errors
    assert watcher.of(ADHESION, found) == []


def test_a_master_starts_its_drives_by_number_until_another_is_heard(vcan, watcher, tmp_path):
    config = tmp_path / "train.toml"
    config.write_text("[canopen]\nnmt_master = true\n", encoding="utf-8")
    process = run(vcan, "--config", str(config))
    watcher.until(lambda: watcher.of(HEARTBEAT))
    bus = watcher.bus

    def pre_operational():
        for node in (1, 3, 5):
            assert bus.send(Frame(0, 0x700 + node, b"\x7f")) is SendResult.SENT

    pre_operational()
    watcher.until(lambda: len(watcher.of(NMT)) >= 2)
    assert [f.data for f in watcher.of(NMT)[:2]] == [b"\x01\x01", b"\x01\x03"]
    assert bus.send(Frame(0, NMT, b"\x80\x00")) is SendResult.SENT
    time.sleep(0.2)
    heard = time.monotonic_ns()
    pre_operational()
    watcher.until(lambda: len(watcher.of(HEARTBEAT, heard + 2000 * MS)) > 0)
    assert watcher.of(NMT, heard) == []
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert b"another NMT master" in errors
