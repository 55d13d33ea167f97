"""`python -m bench.fleet_kills [LOGS KILLS]`: many small logs, workers killed all the time.

Prints how long the fleet takes undisturbed and with the kills, and compares: every log has one file
in the result, its bytes those of the undisturbed run.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from bench.speed import quiet
from gateway.fleet import run as fleet
from gateway.fleet.logs import Job, files_in, find, settings_for
from gateway.fleet.table import DONE, Row
from gateway.settings.config import load

SECONDS = 1
KINDS = 20
"""Different logs; the others are links to them."""


def make(folder: Path, count: int) -> None:
    for k in range(count):
        log = folder / f"train{k % 7}" / f"{k}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        if k < KINDS:
            seconds = str(SECONDS * (1 + k / KINDS))
            quiet("sim", "wet_one" if k % 2 else "healthy", "--duration", seconds, "-o", str(log))
        else:
            os.link(folder / f"train{k % KINDS % 7}" / f"{k % KINDS}.log", log)


def workers() -> list[psutil.Process]:
    found = []
    for process in psutil.Process().children():
        try:
            if "spawn_main" in str(process.cmdline()):
                found.append(process)
        except psutil.Error:
            pass
    return found


def ran(logs: Path, out: Path, ended: Callable[[Job, Row], None]) -> float:
    """The whole fleet in two processes, s."""
    began = time.perf_counter()
    asked = settings_for(load(None), None, out, ("day", "train"))
    fleet.run(fleet.plan(find([str(logs)], out), asked, force=False), asked, 2, None, ended)
    return time.perf_counter() - began


def content(out: Path) -> dict[str, list[bytes]]:
    return {name: [p.read_bytes() for p in paths] for name, paths in files_in(out).items()}


def main(count: int, kills: int) -> None:
    draw, killed, rows = random.Random(36), [], []

    def after(one: Job, row: Row) -> None:
        """Kill one of the two processes so often that all kills happen; not while both start."""
        rows.append((one.name, row.status))
        if len(rows) * kills >= (len(killed) + 1) * count and (alive := workers()):
            process = draw.choice(alive)
            process.kill()
            killed.append(process.pid)

    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        make(here / "logs", count)
        quiet_s = ran(here / "logs", here / "quiet", lambda _one, _row: None)
        print(
            f"{count} logs of {SECONDS} to {2 * SECONDS} s, two processes: {quiet_s:.0f} s",
            flush=True,
        )
        killed_s = ran(here / "logs", here / "killed", after)
        print(f"with {len(killed)} of them killed: {killed_s:.0f} s", flush=True)
        wanted, found = content(here / "quiet"), content(here / "killed")
        bad = [row for row in rows if row[1] != DONE]
        twice = sum(len(each) != 1 for each in found.values())
        print(f"rows {len(rows)}, of different logs {len(set(rows))}, bad {len(bad)}")
        print(f"files {len(found)}, names that are there twice {twice}")
        left = [p for p in (here / "killed").rglob("*") if p.is_file() and p.suffix != ".parquet"]
        print(f"other files left {len(left)}")
        assert len(rows) == len(set(rows)) == len(found) == len(wanted) == count
        assert not bad
        assert not twice
        assert not left
        assert found == wanted
        print("byte-equal: all")


if __name__ == "__main__":
    os.nice(10)
    main(*(int(word) for word in sys.argv[1:] or ("10000", "200")))
