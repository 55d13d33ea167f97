"""The examples that `--help` of each verb ends with: they run, in their order, in one folder."""

import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from gateway import cli
from gateway.commands.help_examples import EXAMPLES
from gateway.hil.vcan.ways import way

ROOT = Path(__file__).parents[2]
MINUTES = ("reproduce", "evaluate thermal", "calibrate")
"""Their options are looked at only; tests of their own run these verbs."""
SERVES = ("run", "monitor")
"""Go on until they are ended."""
PATIENCE_S = 120.0
FLEET = ("logs/monday/a.log", "logs/tuesday/b.log")
"""Logs that a reader has: simulated here."""


def helped(verb):
    text = io.StringIO()
    with redirect_stdout(text), pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    return text.getvalue()


@pytest.mark.parametrize("verb", sorted(set(cli.VERBS) - {"warm"}))
def test_help_ends_with_two_examples_of_real_options(verb):
    shown = re.findall(r"^  traction-gateway (.*)$", helped(verb), re.MULTILINE)
    assert len(EXAMPLES[verb]) >= 2
    assert tuple(shown[-len(EXAMPLES[verb]) :]) == EXAMPLES[verb]
    for example in EXAMPLES[verb]:
        words = shlex.split(example)
        assert words[0] == verb
        cli._parser(words).parse_args(words)


def started(words, folder):
    return subprocess.Popen(
        [sys.executable, "-m", "gateway", *words], cwd=folder, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def await_handler(run):
    """Wait until the program itself decides what SIGTERM does: after seconds of imports."""
    deadline = time.monotonic() + PATIENCE_S
    status = Path(f"/proc/{run.pid}/status")
    while run.poll() is None:
        (caught,) = re.findall(r"^SigCgt:\s*(\S+)$", status.read_text("ascii"), re.MULTILINE)
        if int(caught, 16) >> (signal.SIGTERM - 1) & 1:
            return
        assert time.monotonic() < deadline, "no handler"
        time.sleep(0.05)


def words_of(example):
    """Without a CAN interface: python-can's own bus in its place."""
    return shlex.split(example.replace("socketcan", "virtual"))


@pytest.mark.thorough  # The verbs have tests of their own; their options are looked at above.
@pytest.mark.slow
def test_they_run(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "examples" / "train.toml", tmp_path)
    for name in FLEET:
        (tmp_path / name).parent.mkdir(parents=True)
        assert cli.main(["sim", "healthy", "--duration", "3", "-o", str(tmp_path / name)]) == 0
    for verb, examples in EXAMPLES.items():
        for example in examples:
            if verb not in SERVES and not example.startswith(MINUTES):
                code = cli.main(words_of(example))
                nowhere = verb == "vcan" and way().reason
                assert code == (2 if nowhere else 0), f"{example}\n{capfd.readouterr()}"
    for name in ("drive.log", "demo.png", "drive.csv", "thresholds.toml"):
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.thorough
@pytest.mark.slow
def test_services_serve_until_they_are_ended(tmp_path):
    shutil.copy(ROOT / "examples" / "train.toml", tmp_path)
    assert cli.main(["sim", "wet_one", "--duration", "4", "-o", str(tmp_path / "drive.log")]) == 0
    examples = [one for verb in SERVES for one in EXAMPLES[verb]]
    running = [started(words_of(one), tmp_path) for one in examples]
    for run in running:
        await_handler(run)
    time.sleep(6.0)  # more than they need from there on, and they still run
    for example, run in zip(examples, running, strict=True):
        alive = run.poll() is None
        if alive:
            os.kill(run.pid, signal.SIGTERM)
        _, errors = run.communicate(timeout=300)
        assert alive, f"{example}\n{errors}"
        assert run.returncode == 0, f"{example}\n{errors}"
