"""Python programs in a process of their own: what they print, load and end with."""

import ast
import os
import subprocess
import sys
import time
from pathlib import Path

PATIENCE_S = 60.0
COMMAND = "from gateway.cli import main\nassert main(sys.argv[1:]) == 0"
"""For `loaded`: the command with the words behind it."""


def ended(*words, folder=None, **changes):
    """How Python ends with these words; changes: of the environment, None takes out."""
    environment = {k: v for k, v in (os.environ | changes).items() if v is not None}
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, env=environment, capture_output=True,
        text=True, check=False, timeout=1200,
    )  # fmt: skip


def gateway(*words, **more):
    """The same of `traction-gateway`."""
    return ended("-m", "gateway", *words, **more)


def printed(text, *words, **more):
    """Lines that a program prints, which ends well."""
    done = ended("-c", text, *words, **more)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def await_state(pid, state):
    """Wait until the kernel says that a process is in a state: T stopped, S asleep."""
    deadline = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{pid}/stat").read_text("ascii").rsplit(")", 1)[1].split()[0] != state:
        assert time.monotonic() < deadline, f"process {pid} is not {state}"
        time.sleep(0.001)


def loaded(names, text, *words, **more):
    """Which of these modules a program has loaded at its end."""
    last = f"\nprint([name for name in {tuple(names)} if name in sys.modules])"
    return ast.literal_eval(printed(f"import sys\n{text}{last}", *words, **more)[-1])
