"""The `run` command as a process of its own on a real bus: hanging, ending, links, NMT."""

import re
import signal
import subprocess
import sys
import time

import pytest

from dbc.codec import bind
from dbc.frame import Frame
from gateway.core.codes import Reason
from gateway.io.socketcan import SocketCan
from gateway.io.transport import SendResult
from gateway.settings.config import shipped_dbc
from tests.buses import frames_of
from tests.hil.observer import await_stop

pytestmark = pytest.mark.vcan

PATIENCE_S = 60.0
"""Loading the program takes seconds in user-mode-linux."""
ATTEMPTS = 5
"""Of a tick that is too late the flags are not sent, just that one's every time they should be."""
ADHESION, STATUS, HEARTBEAT, EMERGENCY, NMT = 0x1A0, 0x4A0, 0x720, 0x0A0, 0x000


class Watcher:
    """Everything heard on the bus so far."""

    def __init__(self, name):
        self.bus = SocketCan(name)
        self.bus.open()
        self.frames = []

    def of(self, can_id):
        self.frames += frames_of(self.bus)
        return [f for f in self.frames if f.can_id == can_id]

    def until_more(self, count, can_id):
        """Wait for so many more."""
        wanted = len(self.of(can_id)) + count
        self.until(lambda: len(self.of(can_id)) >= wanted)

    def until_quiet(self, seconds, *ids):
        """Wait until none of these has come for so long; then whatever was on its way is here."""
        heard, since = -1, time.monotonic()

        def quiet():
            nonlocal heard, since
            before, heard = heard, sum(len(self.of(can_id)) for can_id in ids)
            if heard != before:
                since = time.monotonic()
            return time.monotonic() - since > seconds

        self.until(quiet)

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
    watcher.until_more(50, ADHESION)
    assert watcher.of(HEARTBEAT)[0].data == b"\x00"
    assert watcher.of(HEARTBEAT)[-1].data == b"\x05"
    process.send_signal(signal.SIGSTOP)
    await_stop(process.pid)
    watcher.until_quiet(1.0, ADHESION, HEARTBEAT)
    before = len(watcher.of(STATUS))
    process.send_signal(signal.SIGCONT)
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))

    def missed():
        # Not the first status: the signal may have come in the middle of a tick.
        told = [codec.decode(codec.by_id[STATUS], f.data) for f in watcher.of(STATUS)[before:]]
        return max((status["DeadlineMisses"].value for status in told), default=0)

    watcher.until(lambda: missed() > 0)
    assert missed() >= 95  # in a second, of which the ticks at its ends may be done
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    assert b"ticks missed" in output
    last = [codec.decode(codec.by_id[ADHESION], f.data) for f in watcher.of(ADHESION)[-3:]]
    assert {reading[f"Adhesion{n}"].raw for reading in last for n in (1, 2, 3)} == {0}
    final = codec.decode(codec.by_id[STATUS], watcher.of(STATUS)[-1].data)
    assert codec.by_id[STATUS].signals[2].labels[int(final["State"].raw)] == "Silent"


def last_reason(vcan, watcher, config):
    """Of a gateway that shall stop and finds another sender; flags of it that were too late."""
    process = run(vcan, "--config", str(config))
    told = len(watcher.of(EMERGENCY))
    watcher.until_more(50, ADHESION)
    vcan.send("1A0#0000000000000000")
    watcher.until(lambda: any(f.data[:2] == b"\x50\x81" for f in watcher.of(EMERGENCY)[told:]))
    watcher.until_quiet(1.0, ADHESION)
    found = len(watcher.of(ADHESION))
    watcher.until_more(10, HEARTBEAT)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    assert b"on_intruder" in errors
    assert len(watcher.of(ADHESION)) == found
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))
    last = codec.decode(codec.by_id[ADHESION], watcher.of(ADHESION)[-1].data)
    late = re.search(rb"too late to be sent (\d+)", output)
    assert late is not None
    return int(last["Reason"].raw), int(late[1])


def test_a_second_sender_of_our_identifiers_silences_a_gateway_that_shall_stop(
    vcan, watcher, tmp_path
):
    config = tmp_path / "stop.toml"
    config.write_text('[bus]\non_intruder = "stop"\n')
    for _ in range(ATTEMPTS):
        reason, late = last_reason(vcan, watcher, config)
        if reason == Reason.INTRUDER:
            return
        assert late, "the flags of the tick that found it were not held back"
    pytest.fail("no flag says that there is an intruder")


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
    # A heartbeat of a tick after the one that has read it; what was sent before is here by then.
    watcher.until_more(3, HEARTBEAT)
    starts = len(watcher.of(NMT))
    pre_operational()
    watcher.until_more(20, HEARTBEAT)
    assert len(watcher.of(NMT)) == starts
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert b"another NMT master" in errors
