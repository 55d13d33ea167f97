"""A fleet of logs in two processes against one, in the same run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.speed import child, quiet

SIZES = ((8, 60, 2), (48, 60, 1), (48, 300, 1))
"""Logs, seconds of each, rounds, of which the best counts.

A log of a minute takes a third of a second, and every worker three seconds to start and to end,
whatever there is to do: the first is all start, the last is some hours of recordings.
"""


def fleet(logs: Path, jobs: int, *words: str) -> float:
    """The whole command over all logs, start and end included, s."""
    return child("fleet", str(logs), "-o", str(logs.with_suffix(".out")), "-j", str(jobs), *words)


def alone(logs: Path, count: int) -> float:
    """So many processes of `replay` at the same time, a log each: what the machine can give, s."""
    began = time.perf_counter()
    words = [sys.executable, "-m", "gateway", "replay"]
    children = [
        subprocess.Popen([*words, str(log)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for log in sorted(logs.iterdir())[:count]
    ]
    assert not any(one.wait() for one in children)
    return time.perf_counter() - began


def rows() -> list[tuple[str, ...]]:
    """One row per figure: what, one process, two processes, ratio; measured in turns."""
    table = []
    with tempfile.TemporaryDirectory() as name:
        for count, seconds, rounds in SIZES:
            log = Path(name) / f"{seconds}.log"
            if not log.exists():
                quiet("sim", "healthy", "--duration", str(seconds), "-o", str(log))
            logs = Path(name) / f"logs{count}of{seconds}"
            logs.mkdir()
            for k in range(count):
                os.link(log, logs / f"{k}.log")
            turns = [[fleet(logs, jobs, "--force") for jobs in (1, 2)] for _ in range(rounds)]
            one, two = (min(times) for times in zip(*turns, strict=True))
            what = f"fleet of {count} logs of {seconds} s, whole command"
            table.append((what, f"{one:.2f} s", f"{two:.2f} s", f"{one / two:.2f} x"))
        turns = [[alone(logs, count) for count in (1, 2)] for _ in range(3)]
        single, pair = (min(times) for times in zip(*turns, strict=True))
        again = fleet(logs, 2)
    what = f"plain `replay` of {seconds} s, a log per process: the limit of the machine"
    ratio = f"{2 * single / pair:.2f} x"
    table.append((what, f"{single:.2f} s for 1", f"{pair:.2f} s for 2", ratio))
    what = f"the fleet of {count} logs of {seconds} s again, nothing to do"
    table.append((what, "", f"{again:.2f} s", ""))
    return table


HEADER = ("figure", "one process", "two processes", "ratio")
