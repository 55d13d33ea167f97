"""The gateway as the service that systemd starts: nobody's, without rights, on a real bus."""

import os
import select
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import gateway
from dbc.codec import bind
from dbc.e2e import crc_ok
from gateway.io.socketcan import SocketCan
from gateway.settings.config import shipped_dbc
from tests.buses import frames_of

pytestmark = pytest.mark.vcan

PATIENCE_S = 120.0
NOBODY = 65534
ROOT = Path(gateway.__path__[0]).parent
ADHESION = 0x1A0


@pytest.fixture
def shared():
    """A folder that nobody in particular may look into, and write to its `tmp` only."""
    folder = Path(tempfile.mkdtemp(dir="/dev/shm"))
    folder.chmod(0o755)
    (folder / "tmp").mkdir()
    (folder / "tmp").chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


class Manager:
    """The service manager's end."""

    def __init__(self, folder):
        self.path = folder / "notify"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(self.path))
        self.path.chmod(0o666)

    def until(self, line, process):
        """Wait for a line; a process that has ended will not send it."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if select.select([self.socket], [], [], 1.0)[0]:
                if line in self.socket.recv(4096).decode().splitlines():
                    return
            elif process.poll() is not None:
                break
        process.terminate()
        _, errors = process.communicate(timeout=PATIENCE_S)
        raise AssertionError(f"{line}: not within {PATIENCE_S} s\n{errors.decode()}")


@pytest.fixture
def manager(shared):
    manager = Manager(shared)
    yield manager
    manager.socket.close()


def open_to_all(*wanted):
    """Shell lines that make paths reachable for everybody, in a mount namespace of one's own.

    An interpreter or a checkout below somebody's home is not what a service would be given: such
    a home is covered there by an empty folder that holds the wanted paths only.
    """
    closed = {
        next((p for p in (*reversed(path.parents), path) if not p.stat().st_mode & 0o001), None)
        for path in wanted
    } - {None}
    under = [path for path in wanted if any(path.is_relative_to(top) for top in closed if top)]
    lines = ["set -e", "aside=$(mktemp -d -p /dev/shm)", "mount -t tmpfs tmpfs $aside"]
    for k, path in enumerate(under):
        lines += [f"mkdir $aside/{k}", f"mount --bind {shlex.quote(str(path))} $aside/{k}"]
    lines += [f"mount -t tmpfs -o mode=755 tmpfs {shlex.quote(str(top))}" for top in closed]
    for k, path in enumerate(under):
        lines += [f"mkdir -p {shlex.quote(str(path))}",
                  f"mount --bind $aside/{k} {shlex.quote(str(path))}"]  # fmt: skip
    return "\n".join([*lines, "umount -l $aside", "rmdir $aside"])


def nobodys(vcan, manager, *words):
    """`run` as uid nobody without capabilities, home or a place to write but a temporary one."""
    nobody = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
              "--no-new-privs", "--bounding-set=-all", "--inh-caps=-all")  # fmt: skip
    program = (sys.executable, "-m", "gateway", "run", "-v", "--quiet")
    command = shlex.join([*nobody, *program, "-i", "socketcan", "-c", vcan.name, *words])
    script = f"{open_to_all(Path(sys.base_prefix), ROOT)}\nexec {command}"
    environment = {
        "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "HOME": "/nonexistent",
        "TMPDIR": str(manager.path.parent / "tmp"), "PYTHONDONTWRITEBYTECODE": "1",
        "NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "500000",
    }  # fmt: skip
    return vcan.start("unshare", "--mount", "sh", "-c", script, cwd=ROOT, env=environment,
                      stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip


def flags(bus, count):
    deadline = time.monotonic() + PATIENCE_S
    found = []
    while len(found) < count:
        assert time.monotonic() < deadline, f"{len(found)} of {count} flag frames"
        time.sleep(0.01)
        found += [f for f in frames_of(bus) if f.can_id == ADHESION]
    return found


def test_nobody_without_rights_sends_flags(vcan, manager, shared):
    mapped = Path("/proc/self/uid_map").read_text(encoding="ascii").split()
    if int(mapped[2]) <= NOBODY:
        pytest.skip("only one user exists in this user namespace: run the tests as root")
    bus = SocketCan(vcan.name)
    bus.open()
    process = nobodys(vcan, manager)
    manager.until("READY=1", process)
    manager.until("WATCHDOG=1", process)
    spec = bind(shipped_dbc("traction.dbc"), (1, 2, 3)).by_id[ADHESION]
    assert all(crc_ok(spec, frame.data) for frame in flags(bus, 50))
    lines = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii").splitlines()
    said = {key: value.split() for key, value in (line.split(":", 1) for line in lines)}
    assert said["Uid"] == said["Gid"] == [str(NOBODY)] * 4
    assert {said[f"Cap{kind}"][0] for kind in ("Inh", "Prm", "Eff", "Bnd", "Amb")} == {"0" * 16}
    assert said["NoNewPrivs"] == ["1"]
    vcan.link("down")
    manager.until(f"STATUS=waits: {vcan.name} is down", process)
    manager.until("WATCHDOG=1", process)
    vcan.link("up")
    manager.until(f"STATUS=runs on socketcan {vcan.name}", process)
    flags(bus, 10)
    process.send_signal(signal.SIGTERM)
    manager.until("STOPPING=1", process)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors.decode()
    text = errors.decode()
    assert f"user {NOBODY}, SCHED_OTHER 0" in text
    # What it copied for itself is gone.
    assert list((shared / "tmp").iterdir()) == []
    bus.close()


def test_the_link_script_makes_a_bench_bus_and_leaves_it_alone(vcan):
    def script():
        words = ["sh", str(ROOT / "gateway/service/links.sh"), vcan.name]
        environment = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "TYPE": "vcan",
                       "DATA_BITRATE": "5000000", "TXQUEUELEN": "7"}  # fmt: skip
        done = subprocess.run(
            words, env=environment, capture_output=True, text=True, check=False
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    def shown():
        words = ["ip", "-details", "link", "show", vcan.name]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout

    vcan.link("delete")
    assert "is set up" in script()
    assert "vcan" in shown()
    assert "mtu 72" in shown()
    assert "qlen 7" in shown()
    assert ",UP" in shown().split(">")[0]
    before = shown()
    assert "left as it is" in script()
    assert shown() == before
    least = Path("/proc/sys/net/core/rmem_max")
    if vcan.own_kernel:
        assert int(least.read_text(encoding="ascii")) >= 8 << 20
    # A real controller that is down and cannot be given a bit rate is a failure that is seen.
    vcan.link("down")
    words = ["sh", str(ROOT / "gateway/service/links.sh"), vcan.name]
    environment = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "BITRATE": "500000"}
    refused = subprocess.run(words, env=environment, capture_output=True, check=False)
    assert refused.returncode != 0
    assert ",UP" not in shown().split(">")[0]
