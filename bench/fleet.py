"""A fleet of logs in two processes against one, in the same run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.speed import child, quiet

LOGS = 8
SECONDS = 60.0
ROUNDS = 3


def fleet(folder: Path, jobs: int) -> float:
    """The whole command over all logs, start and end included, s."""
    out = folder / f"out{jobs}"
    shutil.rmtree(out, ignore_errors=True)
    return child("fleet", str(folder / "logs"), "-o", str(out), "-j", str(jobs))


def alone(folder: Path, count: int) -> float:
    """So many processes of `replay` at the same time, a log each: what the machine can give, s."""
    began = time.perf_counter()
    logs = sorted((folder / "logs").iterdir())[:count]
    words = [sys.executable, "-m", "gateway", "replay"]
    children = [
        subprocess.Popen([*words, str(log)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for log in logs
    ]
    assert not any(one.wait() for one in children)
    return time.perf_counter() - began


def rows() -> list[tuple[str, ...]]:
    """One row per figure: what, one process, two processes, ratio. The best of each in turns."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        for k in range(LOGS):
            log = folder / "logs" / f"{k}.log"
            quiet("sim", "healthy", "--duration", str(SECONDS), "-o", str(log))
        turns = [
            (fleet(folder, 1), fleet(folder, 2), alone(folder, 1), alone(folder, 2))
            for _ in range(ROUNDS)
        ]
        one, two, single, pair = (min(times) for times in zip(*turns, strict=True))
        again = child("fleet", str(folder / "logs"), "-o", str(folder / "out2"), "-j", "2")
    return [
        (f"fleet of {LOGS} logs of {SECONDS:.0f} s, whole command",
         f"{one:.2f} s", f"{two:.2f} s", f"{one / two:.2f} x"),
        (f"plain `replay`, a log per process ({os.cpu_count()} hyperthreads here)",
         f"{single:.2f} s for 1", f"{pair:.2f} s for 2", f"{2 * single / pair:.2f} x"),
        ("the same fleet again, nothing to do", "", f"{again:.2f} s", ""),
    ]  # fmt: skip


HEADER = ("figure", "one process", "two processes", "ratio")
