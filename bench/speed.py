"""Speed of replay and start, against references in the same run."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import can
import cantools

from gateway.cli import main
from gateway.config import shipped_dbc

SECONDS = 60.0


def best(task: Callable[[], object], times: int = 3) -> float:
    """Shortest of a few runs, s: the least disturbed one."""
    spent = []
    for _ in range(times):
        began = time.perf_counter()
        task()
        spent.append(time.perf_counter() - began)
    return min(spent)


def quiet(*words: str) -> None:
    """One command of ours in this process, its output dropped."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = main(list(words))
    assert code == 0, words


def library_decode(log: Path) -> None:
    """What a user writes with the libraries alone: read and decode, no estimation."""
    database = cantools.database.load_file(shipped_dbc("traction.dbc"))
    known = {message.frame_id: message for message in database.messages}
    for frame in can.LogReader(log):
        message = known.get(frame.arbitration_id)
        if message is not None:
            message.decode(frame.data)


def child(*words: str) -> float:
    """A whole process of ours, s."""
    command = [sys.executable, "-m", "gateway", *words]
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began


def rows() -> list[tuple[str, ...]]:
    """One row per figure: what, measured, reference, ratio."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "minute.log"
        quiet("sim", "healthy", "--duration", str(SECONDS), "-o", str(log))
        out = [Path(folder) / f"out{k}.log" for k in range(2)]
        ours = best(lambda: quiet("replay", str(log), "-o", str(out[0])))
        quiet("replay", str(log), "-o", str(out[1]))
        same = out[0].read_bytes() == out[1].read_bytes()
        theirs = best(lambda: library_decode(log), 2)
        simulate = best(lambda: quiet("sim", "healthy", "-o", str(Path(folder) / "s.log")), 1)
    bare = best(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True), 5)
    usage = best(lambda: child("--help"), 5)
    verb = best(lambda: child("replay", "--help"), 3)
    return [
        (f"replay of {SECONDS:.0f} s, 3 drives, estimation and detection included",
         f"{ours:.2f} s", f"real time {SECONDS:.0f} s", f"{SECONDS / ours:.1f} x"),
        ("the same against LogReader + cantools (read and decode only)",
         f"{ours:.2f} s", f"{theirs:.2f} s", f"{theirs / ours:.2f} x"),
        ("two replays of one log", "byte-identical" if same else "DIFFERENT", "", ""),
        ("simulation of 10 s into a log", f"{simulate:.2f} s", "real time 10 s",
         f"{10 / simulate:.1f} x"),
        ("`--help`, whole process", f"{usage * 1e3:.0f} ms", f"bare Python {bare * 1e3:.0f} ms",
         f"{usage / bare:.1f}"),
        ("`replay --help`, whole process", f"{verb * 1e3:.0f} ms", "", ""),
    ]  # fmt: skip


HEADER = ("figure", "measured", "reference in the same run", "ratio")
