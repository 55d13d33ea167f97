"""Authenticated flags between processes on a real bus, and what an attacker gets there."""

import random
import signal
import subprocess
import sys
import time

import pytest

from dbc.codec import bind
from dbc.frame import Frame
from dbc.secoc_receiver import SURE, Verifier
from gateway.io.socketcan import SocketCan
from gateway.settings.config import shipped_dbc
from tests.buses import frames_of

pytestmark = pytest.mark.vcan

KEY = bytes(range(16))
PATIENCE_S = 90.0
"""Loading the program takes seconds in user-mode-linux."""
ADHESION, FAULTS, AUTH, DRIVE = 0x1A0, 0x2A0, 0x320, 0x181


class Listener:
    """A receiver of authenticated flags with a socket of its own."""

    def __init__(self, name, codec):
        self.bus, self.codec = SocketCan(name), codec
        self.bus.open()
        self.receiver = Verifier(KEY, 1 << 40)
        self.heard = []
        self.genuine = []

    def take(self, timeout_s=0.05):
        time.sleep(timeout_s)
        for frame in frames_of(self.bus):
            self.heard.append(frame)
            if frame.can_id in (ADHESION, FAULTS):
                self.receiver.flag(frame.can_id, frame.data, frame.t_ns)
            elif frame.can_id == AUTH:
                said = self.codec.decode(self.codec.by_id[AUTH], frame.data)
                low, mac = int(said["Freshness"].raw), int(said["Mac"].raw)
                found = self.receiver.auth(low, mac, frame.t_ns)
                if found is not None:
                    self.genuine.append(found)

    def until_heard(self, can_id):
        """Until somebody has sent this."""
        deadline = time.monotonic() + PATIENCE_S
        while can_id not in {frame.can_id for frame in self.heard}:
            assert time.monotonic() < deadline, f"no {can_id:X} within {PATIENCE_S} s"
            self.take()

    def until_more(self, count):
        """Until so many more flags are genuine."""
        wanted, deadline = len(self.genuine) + count, time.monotonic() + PATIENCE_S
        while len(self.genuine) < wanted:
            assert time.monotonic() < deadline, f"not within {PATIENCE_S} s: {self.receiver.failed}"
            self.take()


def test_flags_stay_genuine_over_forgeries_and_a_killed_gateway(vcan, tmp_path):
    (tmp_path / "auth.key").write_text(KEY.hex())
    (tmp_path / "auth.key").chmod(0o600)
    (tmp_path / "train.toml").write_text("[authentication]\n")
    bus = ("-i", "socketcan", "-c", vcan.name)

    def gateway():
        return vcan.start(
            sys.executable, "-m", "gateway", "run", *bus, "--quiet",
            "--config", str(tmp_path / "train.toml"),
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))
    listener = Listener(vcan.name, codec)
    process = gateway()
    drives = vcan.start(
        sys.executable, "-m", "gateway", "sim", "healthy", *bus, "--duration", "600",
        "--auth-key", str(tmp_path / "auth.key"), "--auth-after", str(1 << 40),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    listener.until_heard(DRIVE)  # the drives verify flags from now on
    listener.until_more(50)
    assert (listener.receiver.failed, listener.receiver.held) == (0, 0)

    # An attacker: tags of no key, flags that nobody vouches for, requests to an SDO server.
    attacker, rng = SocketCan(vcan.name), random.Random(1)
    attacker.open()
    begin = len(listener.genuine)
    for _ in range(500):
        attacker.send(Frame(0, AUTH, rng.randbytes(8)))
        if rng.random() < 0.1:
            attacker.send(Frame(0, ADHESION, bytes(2) + b"\x15" + bytes(5)))
            attacker.send(Frame(0, 0x620, b"\x40\x17\x10\x00\x00\x00\x00\x00"))
        listener.take(0.002)
    listener.until_more(50)
    assert {g.data[2] for g in listener.genuine[begin:]} != {0x15}
    forged = bytes(2) + b"\x15" + bytes(5)
    assert forged not in {g.data for g in listener.genuine}
    assert listener.receiver.failed + listener.receiver.alone > 0
    assert 0x5A0 not in {f.can_id for f in listener.heard}
    assert process.poll() is None, "one forged frame silences nobody"

    # The gateway dies and comes back with a start number of its own.
    process.send_signal(signal.SIGKILL)
    process.wait()
    process = gateway()
    held = listener.receiver.held
    listener.until_more(50)
    assert listener.receiver.held - held == SURE - 1
    assert (tmp_path / "trip").read_text() == "00000002\n"
    assert listener.receiver.freshness >> 40 == 2

    for each in (process, drives):
        each.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    output, errors = drives.communicate(timeout=PATIENCE_S)
    assert drives.returncode == 128 + signal.SIGTERM, errors.decode()
    said = [line for line in output.decode().splitlines() if "flags genuine" in line]
    assert len(said) == 3
    assert all(int(line.split()[2]) > 100 for line in said), said
    attacker.close()
    listener.bus.close()


def test_who_only_listens_sends_nothing(vcan):
    watcher = SocketCan(vcan.name)
    watcher.open()
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "run", "-i", "socketcan", "-c", vcan.name, "--quiet",
         "--listen-only", "--duration", "1"], capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert frames_of(watcher) == []
    assert "sent 0, refused" in done.stdout
    watcher.close()
