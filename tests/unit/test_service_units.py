"""The systemd units as systemd itself judges them, and the script that sets up links."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import gateway

UNITS = Path(gateway.__path__[0]) / "service"
GATEWAY, LINKS = "traction-gateway@.service", "traction-gateway-links@.service"
MOST_EXPOSED = 15
"""Tenths of the scale of `systemd-analyze security`."""


@pytest.fixture
def analyze(request):
    found = shutil.which("systemd-analyze")
    if found is None:
        why = "systemd-analyze is not installed (apt-get install systemd)"
        if request.config.getoption("--require-vcan"):
            pytest.fail(why)
        pytest.skip(why)
    return found


@pytest.fixture
def installed(tmp_path):
    """The units with the programs that they start, in a folder instead of /opt."""
    for name in ("bin/traction-gateway", "libexec/links.sh"):
        program = tmp_path / name
        program.parent.mkdir()
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    for name in (GATEWAY, LINKS):
        text = (UNITS / name).read_text(encoding="utf-8")
        assert "/opt/traction-gateway/" in text
        (tmp_path / name).write_text(text.replace("/opt/traction-gateway", str(tmp_path)))
    return tmp_path


def exposure(analyze, unit, *, most=MOST_EXPOSED):
    """Whether a unit is exposed at most so much, and what systemd says."""
    words = ("security", "--offline=yes", "--no-pager", f"--threshold={most}", str(unit))
    done = subprocess.run([analyze, *words], capture_output=True, text=True, check=False)
    assert "Overall exposure level" in done.stdout, done.stderr
    return done.returncode == 0, done.stdout


def test_systemd_finds_nothing_wrong_with_the_units(analyze, installed):
    for name in (GATEWAY, LINKS):
        words = [analyze, "verify", "--man=no", str(installed / name)]
        environment = {**os.environ, "TMPDIR": str(installed)}  # it leaves a folder behind
        done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
        assert (done.returncode, done.stdout + done.stderr) == (0, "")


@pytest.mark.parametrize(("unit", "most"), [(GATEWAY, MOST_EXPOSED), (LINKS, MOST_EXPOSED - 1)])
def test_the_exposure_is_what_was_promised(analyze, installed, unit, most):
    good, said = exposure(analyze, installed / unit, most=most)
    assert good, said


def test_links_are_set_up_with_one_right_only():
    lines = (UNITS / LINKS).read_text(encoding="utf-8").splitlines()
    for wanted in (
        "DynamicUser=yes", "CapabilityBoundingSet=CAP_NET_ADMIN",
        "AmbientCapabilities=CAP_NET_ADMIN", "SystemCallFilter=~@privileged @resources",
    ):  # fmt: skip
        assert wanted in lines
    # The limit of receive buffers is written below /proc/sys.
    assert not {"ProtectKernelTunables=yes", "ProcSubset=pid"} & set(lines)


@pytest.mark.parametrize("line", ["NoNewPrivileges=yes", "CapabilityBoundingSet="])
def test_the_measure_notices_what_goes_missing(analyze, installed, line):
    # A threshold just above the unit's own figure: each of these lines is worth more than that.
    unit = installed / GATEWAY
    own = next(k for k in range(100) if exposure(analyze, unit, most=k)[0])
    lines = unit.read_text().splitlines()
    gone = {line, "SystemCallFilter=~@privileged @resources"}
    assert gone <= set(lines)
    unit.write_text("\n".join(text for text in lines if text not in gone) + "\n")
    assert not exposure(analyze, unit, most=own)[0]


def test_the_gateway_asks_for_nothing_that_it_is_not_given():
    lines = (UNITS / GATEWAY).read_text(encoding="utf-8").splitlines()
    for wanted in (
        "Type=notify", "WatchdogSec=500ms", "DynamicUser=yes", "CapabilityBoundingSet=",
        "CPUSchedulingPolicy=fifo", "CPUSchedulingResetOnFork=yes", "LimitMEMLOCK=infinity",
        "LogRateLimitIntervalSec=30s",
    ):  # fmt: skip
        assert wanted in lines
    (start,) = (text for text in lines if text.startswith("ExecStart="))
    assert "--realtime" not in start


class Host:
    """A machine on which `ip` and `sysctl` only write down what they are asked."""

    def __init__(self, folder, shown, rmem=212992):
        self.log = folder / "asked"
        self.log.touch()
        tools = folder / "tools"
        tools.mkdir()
        show = f"echo '{shown}'" if shown is not None else "exit 1"
        refuse = f"[ -f {folder}/plain ] && case $* in *berr*) exit 2;; esac"
        script = f'#!/bin/sh\n[ "$2" = show ] && {{ {show}; exit; }}\necho ip $* >>{self.log}\n'
        (tools / "ip").write_text(script + refuse + "\nexit 0\n")
        (tools / "sysctl").write_text(
            f"#!/bin/sh\n[ $1 = -n ] && echo {rmem} || echo sysctl $* >>{self.log}\n"
        )
        for tool in tools.iterdir():
            tool.chmod(0o755)
        self._path = f"{tools}:{os.environ['PATH']}"

    def run(self, **settings):
        return subprocess.run(
            ["sh", str(UNITS / "links.sh"), "can0"],
            env={"PATH": self._path, **settings}, capture_output=True, text=True, check=False,
        )  # fmt: skip

    def asked(self):
        return self.log.read_text().splitlines()


DOWN = "3: can0: <NOARP,ECHO> mtu 16 qdisc noop state DOWN mode DEFAULT group default qlen 10"
UP = "3: can0: <NOARP,UP,LOWER_UP,ECHO> mtu 16 qdisc pfifo_fast state UP mode DEFAULT qlen 10"


def test_a_link_that_is_down_is_set_up(tmp_path):
    host = Host(tmp_path, DOWN)
    done = host.run(BITRATE="500000")
    assert done.returncode == 0, done.stderr
    assert host.asked() == [
        "sysctl -q -w net.core.rmem_max=8388608",
        "ip link set dev can0 type can bitrate 500000 restart-ms 100 berr-reporting on",
        "ip link set dev can0 txqueuelen 16",
        "ip link set dev can0 up",
    ]


def test_fd_and_a_controller_without_error_reports(tmp_path):
    (tmp_path / "plain").touch()
    host = Host(tmp_path, DOWN, rmem=1 << 24)
    done = host.run(BITRATE="500000", DATA_BITRATE="2000000", RESTART_MS="0")
    assert done.returncode == 0, done.stderr
    options = "bitrate 500000 restart-ms 0 dbitrate 2000000 fd on"
    assert host.asked()[:2] == [
        f"ip link set dev can0 type can {options} berr-reporting on",
        f"ip link set dev can0 type can {options}",
    ]


@pytest.mark.parametrize(("shown", "words"), [(UP, "left as it is"), (None, "not there")])
def test_a_link_that_is_up_or_absent_is_left_alone(tmp_path, shown, words):
    host = Host(tmp_path, shown, rmem=1 << 24)
    done = host.run(BITRATE="500000")
    assert done.returncode == 0
    assert words in done.stdout
    assert host.asked() == []


def test_without_a_bit_rate_nothing_is_set_and_it_is_said(tmp_path):
    host = Host(tmp_path, DOWN, rmem=1 << 24)
    done = host.run()
    assert done.returncode != 0
    assert "BITRATE" in done.stderr
    assert host.asked() == []
