"""`python -m bench.fleet_kills [LOGS KILLS]`: many small logs, workers killed all the time.

Compares what comes of them with the same logs replayed one by one, without Dask: every log has one
file in the result, with the same bytes.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from pathlib import Path

import psutil

from bench.speed import quiet
from gateway.fleet import run as fleet
from gateway.fleet.logs import Job, Settings, files_in, find, settings_for
from gateway.fleet.table import DONE, Row
from gateway.fleet.task import one_log
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


def settings(out: Path) -> Settings:
    return settings_for(load(None), None, out, ("day", "train"))


def content(out: Path) -> dict[str, list[bytes]]:
    return {name: [p.read_bytes() for p in paths] for name, paths in files_in(out).items()}


def main(count: int, kills: int) -> None:
    draw, killed, rows = random.Random(36), [], []

    def after(one: Job, row: Row) -> None:
        """Kill one of the two processes so often that all kills happen, at work or in its start."""
        rows.append((one.name, row.status))
        if len(rows) * kills >= (len(killed) + 1) * count and (alive := workers()):
            process = draw.choice(alive)
            process.kill()
            killed.append(process.pid)
        if len(rows) % max(count // 10, 1) == 0:
            print(f"  {len(rows)} logs, {len(killed)} kills, {time.perf_counter() - began:.0f} s",
                  flush=True)  # fmt: skip

    with tempfile.TemporaryDirectory() as name:
        logs, out, alone = (Path(name) / each for each in ("logs", "out", "alone"))
        make(logs, count)
        began = time.perf_counter()
        asked = settings(out)
        fleet.run(fleet.plan(find([str(logs)], out), asked, force=False), asked, 2, None, after)
        print(f"{count} logs of {SECONDS} to {2 * SECONDS} s, two processes, {len(killed)} kills: "
              f"{time.perf_counter() - began:.0f} s", flush=True)  # fmt: skip
        found = content(out)
        bad = [row for row in rows if row[1] != DONE]
        twice = sum(len(each) != 1 for each in found.values())
        print(f"rows {len(rows)}, of different logs {len(set(rows))}, bad {len(bad)}")
        print(f"files {len(found)}, names that are there twice {twice}")
        left = [p for p in out.rglob("*") if p.is_file() and p.suffix != ".parquet"]
        print(f"other files left {len(left)}", flush=True)
        assert len(rows) == len(set(rows)) == len(found) == count
        assert not bad
        assert not twice
        assert not left
        began, asked = time.perf_counter(), settings(alone)
        for one in fleet.plan(find([str(logs)], alone), asked, force=False).todo:
            assert one_log(one, asked).status == DONE
        print(f"one by one: {time.perf_counter() - began:.0f} s")
        assert found == content(alone)
        print("byte-equal: all")


if __name__ == "__main__":
    os.nice(10)
    main(*(int(word) for word in sys.argv[1:] or ("10000", "200")))
