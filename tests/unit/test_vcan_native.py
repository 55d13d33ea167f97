"""`vcan` where the kernel has CAN: what becomes of signals and input. No interface is made here."""

import signal
import subprocess
import sys

import pytest

from gateway.hil.vcan.links import Links

NATIVE = """
import sys
from gateway.hil.vcan import links, ways
ways.way = lambda: ways.Way(prefix=("env",))
links.LOOPBACK = ()
from gateway.cli import main
sys.exit(main(["vcan", "--interfaces", "", "--", *sys.argv[1:]]))
"""
TERMINAL = """
import os, pty, sys
pid, terminal = pty.fork()
if pid == 0:
    os.execv(sys.argv[1], sys.argv[1:])
os.write(terminal, b"abc\\n")
text = b""
while b"got abc" not in text:
    text += os.read(terminal, 1000)
os.write(terminal, b"\\x03")
sys.exit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""


@pytest.mark.parametrize(("kind", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_reaches_the_command(kind, code):
    words = [sys.executable, "-c", NATIVE, "sh", "-c", "echo ready; exec sleep 60"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(kind)
        assert process.wait(timeout=30) == code


def test_input_reaches_the_command():
    words = [sys.executable, "-c", NATIVE, "cat"]
    done = subprocess.run(words, input="x\n", capture_output=True, text=True, check=True)
    assert done.stdout == "x\n"


def test_ctrl_c_and_input_of_a_terminal_reach_the_command_alone():
    asks = "import time; print('got', input()); time.sleep(60)"
    words = [sys.executable, "-c", NATIVE, sys.executable, "-c", asks]
    done = subprocess.run([sys.executable, "-c", TERMINAL, *words], timeout=60, check=False)
    assert done.returncode == 130


def test_a_folder_is_no_record(tmp_path):
    assert Links(record=tmp_path).problems() == [f"--candump {tmp_path}: is a folder; name a file"]
