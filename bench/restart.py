"""How soon a gateway that hangs is replaced, by the times of its systemd unit (promise R27).

systemd itself is not needed: what it would do (wait for the watchdog, SIGABRT, SIGKILL, wait,
start) is done here with the unit's own times, on a gateway that SIGSTOP has stopped: the longest
way, as SIGABRT does not end it. Under a systemd that runs it is `tests/hil/test_systemd.py`.
"""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import can

import gateway

CHANNEL = "239.74.163.10"
FLAGS_ID = 0x1A0
TIMES = 5
STEP_S = 0.137
"""The stop comes at another place between two feedings each time."""
_UNIT_S = {"ms": 1e-3, "s": 1.0, "": 1.0}


def unit_times() -> dict[str, float]:
    """Of the unit that ships, s."""
    unit = Path(gateway.__path__[0]) / "service/traction-gateway@.service"
    text = unit.read_text(encoding="utf-8")
    found = re.findall(r"^(WatchdogSec|TimeoutAbortSec|RestartSec)=(\d+)(ms|s|)$", text, re.M)
    return {key: float(number) * _UNIT_S[unit] for key, number, unit in found}


class Manager:
    """What systemd does for one service."""

    def __init__(self, times: dict[str, float], environment: dict[str, str]) -> None:
        self._times = times
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"\0bench-restart-{os.getpid()}")
        watchdog = str(round(times["WatchdogSec"] * 1e6))
        address = f"@bench-restart-{os.getpid()}"
        self._environment = environment | {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": watchdog}
        self.process = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        """A gateway on a bus that every machine has."""
        words = ("run", "-i", "udp_multicast", "-c", CHANNEL, "--quiet")
        return subprocess.Popen(
            [sys.executable, "-m", "gateway", *words],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=self._environment,
        )  # fmt: skip

    def heard(self, seconds: float) -> bytes:
        """The next word within that time, b"" for none."""
        ready = select.select([self._socket], [], [], seconds)[0]
        return self._socket.recv(4096) if ready else b""

    def until(self, word: bytes) -> None:
        """Wait for a word, a minute at most. Raises TimeoutError."""
        deadline = time.monotonic() + 60.0
        while word not in self.heard(0.1):
            if time.monotonic() > deadline:
                raise TimeoutError(word.decode())

    def replace(self) -> None:
        """Wait until the watchdog has starved; end the process, start another."""
        fed = time.monotonic()
        while (left := fed + self._times["WatchdogSec"] - time.monotonic()) > 0:
            if b"WATCHDOG=1" in self.heard(left):
                fed = time.monotonic()
        self.process.send_signal(signal.SIGABRT)
        try:
            self.process.wait(self._times["TimeoutAbortSec"])
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        time.sleep(self._times["RestartSec"])
        self.process = self.start()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._socket.close()


def restarts(environment: dict[str, str]) -> list[float]:
    """s from a stop to the next flag on the bus, a few times; [] without multicast."""
    try:
        bus = can.Bus(interface="udp_multicast", channel=CHANNEL)
    except (can.CanError, OSError):
        return []
    spent = []
    with bus:
        manager = Manager(unit_times(), environment)
        try:
            for k in range(TIMES):
                manager.until(b"WATCHDOG=1")
                time.sleep(STEP_S * k)
                manager.process.send_signal(signal.SIGSTOP)
                began = time.monotonic()
                while bus.recv(0.0) is not None:
                    pass  # what was sent before
                manager.replace()
                while (message := bus.recv(20.0)) is not None:
                    if message.arbitration_id == FLAGS_ID:
                        spent.append(time.monotonic() - began)
                        break
        finally:
            manager.close()
    return spent


def row(environment: dict[str, str]) -> tuple[str, str, str, str]:
    spent = restarts(environment)
    told = f"{median(spent):.2f} s, at most {max(spent):.2f} s" if spent else "no multicast here"
    what = "a stopped service (SIGSTOP), until its flags are back; the unit's times"
    return what, told, "2 s promised (R27)", f"{2.0 / median(spent):.2f} x" if spent else ""
