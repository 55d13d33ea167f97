"""`vcan -- COMMAND`: exit code, output, signals, files and links of a command that runs inside."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.hil.vcan.ways import way
from tests.docs.test_commands import run_page

VCAN = (sys.executable, "-m", "gateway", "vcan")
HERE = Path(__file__).parents[2]
ON_A_BUS = "no, tests/hil runs it where there is SocketCAN"


@pytest.fixture(autouse=True)
def somewhere(request):
    if way().reason:
        obliged = request.config.getoption("--require-vcan")
        (pytest.fail if obliged else pytest.skip)(way().reason)


def vcan(*words, folder, **environment):
    return subprocess.run(
        [*VCAN, *words], capture_output=True, text=True, check=False, cwd=folder, timeout=600,
        env={**os.environ, "PYTHONPATH": str(HERE), **environment},
    )  # fmt: skip


def test_what_a_command_does_comes_through(tmp_path):
    inside = (
        'echo "$GREETING"; echo bad >&2; pwd; echo kept >file; '
        "candump -n 1 there >other & until grep -q there /proc/net/can/rcvlist_all; do :; done; "
        "cansend vcan0 123#01; cansend vcan1 456##1AABB; cansend a 1A0#02; wait %1; exit 7"
    )
    done = vcan(
        "--interfaces", "vcan0,vcan1", "--pair", "a,there", "--candump", "bus.log", "--",
        "sh", "-c", inside, folder=tmp_path, GREETING="it's me",
    )  # fmt: skip
    assert done.returncode == 7, done.stderr
    assert done.stdout.splitlines() == ["it's me", str(tmp_path)]
    assert "bad" in done.stderr.splitlines()
    assert (tmp_path / "file").read_text() == "kept\n"
    assert (tmp_path / "other").read_text().split() == ["there", "1A0", "[1]", "02"]
    recorded = [
        line.split(") ")[1].strip() for line in (tmp_path / "bus.log").read_text().splitlines()
    ]
    assert recorded[0] == "vcan0 123#01"
    assert recorded[1].startswith("vcan1 456##")
    assert {"a 1A0#02", "there 1A0#02"} >= set(recorded[2:])


OTHER = pytest.mark.thorough
"""The second signal takes the same way; each test here starts a kernel of its own."""


@pytest.mark.parametrize("kind", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=OTHER)])
def test_a_signal_is_for_the_command(tmp_path, kind):
    waits = (
        "import signal, sys, time\n"
        f"signal.signal({int(kind)}, lambda *_: sys.exit(9))\n"
        "print('ready', flush=True)\n"
        "time.sleep(600)\n"
    )
    command = [*VCAN, "--", sys.executable, "-c", waits]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=HERE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(kind)
        assert process.wait(timeout=300) == 9


@pytest.mark.parametrize(
    ("kind", "code"), [pytest.param(signal.SIGTERM, 143, marks=OTHER), (signal.SIGINT, 130)]
)
def test_a_signal_ends_a_command_that_does_not_handle_it(kind, code):
    sleeps = "import time; print('ready', flush=True); time.sleep(60)"
    command = [*VCAN, "--", sys.executable, "-c", sleeps]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=HERE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(kind)
        assert process.wait(timeout=30) == code


def test_what_a_command_sends_when_it_is_ended_is_recorded(tmp_path):
    sends = "trap 'cansend vcan0 7FF#AA; exit 5' TERM; cansend vcan0 123#01; "
    sends += "echo ready; sleep 60 & wait"
    command = [*VCAN, "--candump", str(tmp_path / "bus.log"), "--", "sh", "-c", sends]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=HERE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 5
    recorded = (tmp_path / "bus.log").read_text().splitlines()
    assert [line.split()[-1] for line in recorded] == ["123#01", "7FF#AA"]


def test_no_input_is_lost_without_a_word(tmp_path):
    done = subprocess.run(
        [*VCAN, "--", "cat"], input="x\n", capture_output=True, text=True, check=True, cwd=HERE
    )
    warned = "a command in user-mode-linux has no standard input" in done.stderr
    assert warned != (done.stdout == "x\n")


def test_a_link_goes_to_bus_off_and_is_unplugged(tmp_path):
    state = "ip -d link show can0 | grep -o 'state BUS-OFF'"
    inside = (
        "echo bus-off >$VCAN_FIFOS/can0; "
        f"until {state}; do sleep 0.05; done; echo unplug >$VCAN_FIFOS/can0; "
        "while ip link show can0 >/dev/null 2>&1; do sleep 0.05; done"
    )
    done = vcan("--interfaces", "", "--slcan", "can0", "--", "sh", "-c", inside, folder=tmp_path)
    # A machine's own kernel makes such links outside of the namespace: as the tutorial says.
    outside = bool(way().prefix) and "slcan links appear outside" in done.stderr
    assert (done.returncode, done.stdout) == ((125, "") if outside else (0, "state BUS-OFF\n"))


def test_a_test_has_an_interface_of_its_own(tmp_path):
    (tmp_path / "test_bus.py").write_text(
        "import can\n"
        "def test_frames_arrive(socketcan):\n"
        "    one, other = (can.Bus(socketcan, 'socketcan', fd=True) for _ in range(2))\n"
        "    with one, other:\n"
        "        one.send(can.Message(arbitration_id=0x181, data=[1] * 12, is_fd=True))\n"
        "        assert len(other.recv(60.0).data) == 12\n"
    )
    plugin = "" if "traction_gateway" in _plugins() else "-p gateway.hil.pytest.plugin"
    done = vcan(
        "--", sys.executable, "-m", "pytest", "--require-socketcan", *plugin.split(),
        "-p", "no:cacheprovider", folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout


@pytest.mark.thorough
def test_the_tutorial_works(tmp_path):
    """Its recording, its bus-off and its fixture are in the tests above."""
    assert run_page("docs/tutorials/vcan.md", ON_A_BUS, tmp_path)


def _plugins():
    from importlib.metadata import entry_points

    return {entry.name for entry in entry_points(group="pytest11")}
