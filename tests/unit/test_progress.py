"""What takes long shows the time left on a terminal, and nothing in a pipe."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.commands.progress import Progress, stepped, track

ROOT = Path(__file__).parents[2]
LEFT = re.compile(r"left (?:\x1b\[[\d;]*m)*(?:-:--:--|\d+:\d\d:\d\d)")


def on_terminal(*words, cwd, until=None):
    """Exit code, and what the program wrote to a pseudo-terminal.

    until: the program waits for the file `shown`, which is made once this text has been read, or
    has not come in a minute.
    """
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "120"}
    with subprocess.Popen(
        words, cwd=cwd, stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    ) as process:
        os.close(theirs)
        data = b""
        while until and until.encode() not in data and select.select([ours], [], [], 60)[0]:
            data += read(ours)
        if until:
            (cwd / "shown").touch()
        while chunk := read(ours):
            data += chunk
    os.close(ours)
    return process.returncode, data.decode()


def read(descriptor):
    """Linux ends a pseudo-terminal without a writer with an error."""
    try:
        return os.read(descriptor, 1 << 16)
    except OSError:
        return b""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a log of three drives, in which the second loses adhesion."""
    made = tmp_path_factory.mktemp("progress")
    assert main(["sim", "demo", "--duration", "5", "-o", str(made / "three.log")]) == 0
    return made


PROGRAM = sys.executable, "-m", "gateway"
VERBS = {
    "sim": ("sim", "healthy", "--duration", "1", "-o", "out.log"),
    "replay": ("replay", "three.log"),
    "replay --results": ("replay", "three.log", "--results", "results"),
    "convert": ("convert", "three.log", "out.csv"),
    "check --log": ("check", str(ROOT / "examples" / "train.toml"), "--log", "three.log"),
    "hil": ("hil", "silent"),
    "fleet": ("fleet", "three.log", "-o", "table", "-j", "1"),
    "calibrate": ("calibrate", "three.log", "-o", "limits.toml", "--without-model"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_terminal_is_told_the_time_left_and_a_pipe_is_not(verb, folder, monkeypatch, capfd):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(folder)
    code = main([*VERBS[verb]])
    piped = "".join(capfd.readouterr())
    assert code in (0, 1), piped
    code_there, shown = on_terminal(*PROGRAM, *VERBS[verb], cwd=folder)
    assert code_there == code
    assert LEFT.search(shown), shown[-2000:]
    assert not LEFT.search(piped)
    assert "\x1b" not in piped


@pytest.mark.parametrize("made", [".libraries", ".program", ".tools"])
def test_make_counts_the_seconds_of_an_installation_that_is_silent(made, tmp_path):
    """A program that prints nothing stands for Python and pip, and ends once seconds are shown."""
    venv, silent = tmp_path / "venv", tmp_path / "bin" / "silent"
    for path in (silent, venv / "bin" / "pip"):
        path.parent.mkdir(parents=True)
        path.write_text("#!/bin/sh\nwhile [ ! -e shown ]; do sleep 0.1; done; exit 7\n")
        path.chmod(0o755)
    if made != ".libraries":
        (venv / ".libraries").touch()
    if made == ".tools":
        (venv / ".program").touch()
    words = "make", "-f", str(ROOT / "Makefile"), f"VENV={venv}", f"PYTHON={silent}"
    for name in ("requirements.lock", "requirements-demo.lock", "requirements-compiler.lock",
                 "pyproject.toml", "setup.py", "core_build.py"):  # fmt: skip
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1, 1))
    code, shown = on_terminal(*words, str(venv / made), cwd=tmp_path, until="1 s\r")
    assert code == 2
    assert "1 s\r" in shown, shown
    assert "Error 7" in shown


def test_the_steps_of_a_bar_are_counted_when_they_are_done(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with Progress("first", 2) as progress:
        step = stepped(progress)
        for what in ("one", "two"):
            step(what)
        progress.print("[said] above")
        task = progress._bar.tasks[0]
        assert (task.description, task.completed, task.total) == ("two", 1, 2)
        progress.advance()
        assert task.finished
    assert "[said] above" in capsys.readouterr().err


def test_a_loop_in_real_time_has_no_thread_that_draws(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    before = set(threading.enumerate())
    with Progress("bus", 30.0, by_itself=False) as progress:
        assert not set(threading.enumerate()) - before
        capsys.readouterr()
        progress.to(15.0)
        assert "50%" in capsys.readouterr().err


def test_in_a_pipe_only_notes_are_written(capsys):
    assert list(track("abc", "letters", 3)) == ["a", "b", "c"]
    with Progress("quiet") as progress:
        progress.to(1.0)
        progress.print("a note")
    assert capsys.readouterr().err == "a note\n"
