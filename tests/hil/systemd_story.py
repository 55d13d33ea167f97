"""What happens to the gateway's units under a running systemd; told as JSON for the tests outside.

Runs as root in the guest (`uml/systemd.sh`), uses nothing but Python, `systemctl` and a socket, and
judges nothing: `test_systemd.py` does. `python systemd_story.py FILE`.
"""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

BUS = "vcan0"
GATEWAY, LINKS = f"traction-gateway@{BUS}.service", f"traction-gateway-links@{BUS}.service"
FLAGS, AUTH = 0x1A0, 0x320
UP = 1
"""IFF_UP."""
ETC = Path("/etc/traction-gateway")
PATIENCE_S = 120.0
STOPPED_S = 3.0
"""After that long a stopped gateway has been found out, whatever a guest's clock makes of it."""
FRAME = struct.Struct("=IB3x8s")


def systemctl(*words):
    done = subprocess.run(["systemctl", *words], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def show(unit, *names):
    lines = systemctl("show", unit, "-p", ",".join(names)).splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line)


def pid():
    return int(show(GATEWAY, "MainPID")["MainPID"])


def journal():
    words = ("journalctl", "--no-pager", "-o", "cat", "-u", GATEWAY)
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout


def until(what, so):
    deadline = time.monotonic() + PATIENCE_S
    while not so():
        if time.monotonic() > deadline:
            systemctl("kill", "-s", "ABRT", GATEWAY)
            raise SystemExit(f"{what}: not within {PATIENCE_S} s\n{systemctl('status', GATEWAY)}"
                             f"{journal()}{systemctl('status', LINKS)}")  # fmt: skip
        time.sleep(0.02)


class Bus:
    """Who hears the gateway."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.bind((BUS,))
        self.socket.settimeout(0.05)

    def heard(self, seconds):
        """(time, identifier) of what comes within so many seconds."""
        found, deadline = [], time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                data = self.socket.recv(FRAME.size)
            except TimeoutError:
                continue
            except OSError:  # the link is down
                break
            found.append((time.monotonic(), FRAME.unpack(data)[0]))
        return found

    def until_flags(self, what):
        """Time of the first flag from now on."""
        self.heard(0.02)
        found = []

        def listen():
            found.extend(t for t, number in self.heard(0.1) if number == FLAGS)
            return bool(found)

        until(what, listen)
        return found[0]


def identity(number):
    """What the kernel says of a process."""
    text = Path(f"/proc/{number}/status").read_text(encoding="ascii")
    said = {key: value.split() for key, value in (x.split(":", 1) for x in text.splitlines())}
    keys = ("Uid", "CapEff", "CapPrm", "CapBnd", "NoNewPrivs", "Seccomp", "VmLck")
    return {key: said[key] for key in keys} | {
        "policy": os.sched_getscheduler(number),
        "priority": os.sched_getparam(number).sched_priority,
    }


def started():
    """Both units by the commands of docs/deploy.md."""
    enabled = systemctl("enable", "--now", LINKS.removesuffix(".service"), GATEWAY)
    until("started", lambda: show(GATEWAY, "ActiveState")["ActiveState"] == "active")
    Bus().until_flags("first flag")
    # udev may start the links unit once more, when it sees the device.
    until("links", lambda: show(LINKS, "ActiveState")["ActiveState"] != "activating")
    link = subprocess.run(
        ["ip", "-d", "link", "show", BUS], capture_output=True, text=True, check=True
    )
    return {
        "enabled": enabled, "link": link.stdout, "links": show(LINKS, "ActiveState", "Result"),
        "rmem_max": int(Path("/proc/sys/net/core/rmem_max").read_text(encoding="ascii")),
        "gateway": show(GATEWAY, "ActiveState", "SubState", "NRestarts", "StatusText"),
        "identity": identity(pid()), "journal": journal(),
    }  # fmt: skip


def stopped():
    """A process that stands: what is heard of it, and how it comes back."""
    bus, before = Bus(), pid()
    bus.until_flags("flags before the stop")
    os.kill(before, signal.SIGSTOP)
    at = time.monotonic()
    bus.heard(0.1)
    silent = bus.heard(STOPPED_S)
    until("another process", lambda: pid() not in (0, before))
    again = bus.until_flags("flags after the stop") - at
    until("active", lambda: show(GATEWAY, "ActiveState")["ActiveState"] == "active")
    return {
        "frames": [t - at for t, _ in silent if t - at < 1.0], "again_s": again,
        "gateway": show(GATEWAY, "ActiveState", "NRestarts"), "journal": journal(),
    }  # fmt: skip


def unplugged():
    """The interface goes and comes: udev starts the links unit, nobody else."""
    before = pid()
    subprocess.run(["ip", "link", "delete", BUS], check=True)
    until("waits", lambda: "waits" in show(GATEWAY, "StatusText")["StatusText"])
    waits = show(GATEWAY, "ActiveState", "StatusText")
    subprocess.run(["ip", "link", "add", BUS, "type", "vcan"], check=True)
    until("up", lambda: bool(int(Path(f"/sys/class/net/{BUS}/flags").read_text("ascii"), 16) & UP))
    Bus().until_flags("flags after plugging in")
    return {"waits": waits, "same": pid() == before}


def with_a_key():
    """Authenticated flags: a key that only root can read, by LoadCredential=."""
    key = ETC / "auth.key"
    key.write_text("000102030405060708090a0b0c0d0e0f\n", encoding="ascii")
    key.chmod(0o600)
    (ETC / f"{BUS}.toml").write_text("[authentication]\n", encoding="ascii")
    extra = Path(f"/etc/systemd/system/{GATEWAY}.d")
    extra.mkdir()
    # The two lines of the unit that stand there as comments.
    unit = Path("/etc/systemd/system/traction-gateway@.service").read_text(encoding="ascii")
    wanted = [
        x[1:] for x in unit.splitlines() if x.startswith(("#LoadCredential=", "#StateDirectory="))
    ]
    (extra / "key.conf").write_text("\n".join(["[Service]", *wanted, ""]), encoding="ascii")
    systemctl("daemon-reload")
    bus = Bus()
    restarted = systemctl("restart", GATEWAY)
    bus.until_flags("flags with a key")
    ids = []

    def listen():
        ids.extend(number for _, number in bus.heard(0.1))
        return ids.count(FLAGS) > 50 and ids[-1] == AUTH

    until("flags with a key", listen)
    state = next(Path("/var/lib").rglob("trip"), None)
    return {
        "restarted": restarted, "lines": wanted, "flags": ids.count(FLAGS), "tags": ids.count(AUTH),
        "trip": state.read_text(encoding="ascii") if state else "", "identity": identity(pid()),
    }  # fmt: skip


def misconfigured():
    """A configuration that cannot be used is not tried again."""
    path = ETC / f"{BUS}.toml"
    path.write_text("[loop]\nperiod_ms = 'fast'\n", encoding="ascii")
    systemctl("restart", GATEWAY)
    until("failed", lambda: show(GATEWAY, "ActiveState")["ActiveState"] == "failed")
    time.sleep(1.0)
    told = show(GATEWAY, "ActiveState", "Result", "ExecMainStatus", "NRestarts")
    path.write_text("", encoding="ascii")
    return {"gateway": told, "journal": journal()}


def killed():
    """Death after death: after five it stays down."""
    systemctl("reset-failed", GATEWAY)
    systemctl("start", "--no-block", GATEWAY)
    deaths, last = 0, 0
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        told = show(GATEWAY, "ActiveState", "MainPID")
        if told["ActiveState"] == "failed":
            break
        now = int(told["MainPID"])
        if now not in (0, last):
            os.kill(now, signal.SIGKILL)
            deaths, last = deaths + 1, now
        time.sleep(0.02)
    time.sleep(1.0)
    silent = not Bus().heard(0.5)
    return {"deaths": deaths, "silent": silent, "gateway": show(GATEWAY, "ActiveState", "Result")}


def ended():
    """Asked to end, in order."""
    systemctl("reset-failed", GATEWAY)
    systemctl("start", GATEWAY)
    Bus().until_flags("flags before the end")
    bus = Bus()
    systemctl("stop", GATEWAY)
    bus.heard(0.2)
    return {
        "gateway": show(GATEWAY, "ActiveState", "Result", "ExecMainStatus"),
        "frames": len(bus.heard(0.5)),
    }  # fmt: skip


CHAPTERS = (started, stopped, unplugged, with_a_key, misconfigured, killed, ended)


def main():
    """All of it, in this order; each goes on where the one before has ended."""
    story = {}
    for chapter in CHAPTERS:
        began = time.monotonic()
        story[chapter.__name__] = chapter()
        print(chapter.__name__, f"{time.monotonic() - began:.1f} s", flush=True)
        Path(sys.argv[1]).write_text(json.dumps(story), encoding="utf-8")


if __name__ == "__main__":
    main()
