"""How small `traction-gateway shrink` makes 48 logs, and how long that takes.

    python -m bench.shrink [--data FOLDER | LOG[:TRAIN.toml] ..]

Logs: the golden ones with each of their detectors, storms by seed (classic CAN, CAN FD, wrong
values), simulated runs among the traffic of a real car, and recordings of wheels and temperatures.
With `--data`, a copy of the shared data, three recorded on the buses of cars as well. Of every log
one change of a flag is drawn, by the log's number: of those to a loss or a fault if there is one.
Logs that are given are shrunk in place of these.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from functools import reduce
from itertools import chain
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from bench.shrink_recordings import Case, cars, recordings
from bench.speed import quiet
from bench.wire import whole
from dbc.candump.writer import Writer
from dbc.codec import bind
from dbc.frame import MS, SECOND
from dbc.frames import join
from gateway.core.flags import FlagKind
from gateway.core.gateway import Gateway
from gateway.io.log_file import OneChannel, open_log
from gateway.io.prepare import prepare
from gateway.io.replay import Briefly, replay
from gateway.logfiles import shrunk_files
from gateway.logfiles.shrink import Wanted, shrink
from gateway.reports.record import Changes
from gateway.settings.config import parse
from tests.golden.test_golden import CASES, HERE
from tests.storm.campaign import config_of
from tests.storm.logged import write_storm

ROOT = Path(__file__).parents[1]
STORMS = (*range(10), *range(1000, 1004), *range(2000, 2006))
STORM_TICKS = 3000
AMONG = ("wet_one", "release", "runaway_sudden")
TRAFFIC = ROOT / "tests/data/logs/kona_ev_2019_head.log"
BEFORE_NS = 50 * MS
BAD = ("AdhesionLost", "Fault")


def goldens() -> Iterator[Case]:
    """Of those whose flags change."""
    for name, (dbc, nodes, detector) in CASES.items():
        log = HERE / f"{name.removesuffix(f'_{detector}')}.log.gz"
        drives = [{"node": n} for n in nodes]
        config = {"dbc": {"file": dbc}, "drive": drives, "adhesion": {"detector": detector}}
        if name != "slow":
            yield Case(f"golden {name}", log, parse(config))


def storms(folder: Path) -> Iterator[Case]:
    """What arrives in a storm, as a candump log."""
    for seed in STORMS:
        path = folder / f"storm_{seed}.log"
        write_storm(path, seed, STORM_TICKS)
        yield Case(f"storm {seed}", path, config_of(seed))


def among(folder: Path) -> Iterator[Case]:
    """Simulated runs, a bus on which a real car talks over and over again."""
    other = whole(TRAFFIC)
    other = other.pick(other.channel == other.channel[0])
    other = other._replace(t_ns=other.t_ns - other.t_ns[0], names=[""])
    span_ns = other.t_ns.item(-1) + MS
    for name in AMONG:
        path, alone = folder / f"{name}.log", folder / "alone.log"
        quiet("sim", name, "-o", str(alone))
        own = whole(alone)._replace(names=[""])
        first, last = own.t_ns[[0, -1]].tolist()
        rounds = [other._replace(t_ns=other.t_ns + t) for t in range(first, last, span_ns)]
        both = reduce(join, [own, *rounds])
        with Writer(path) as writer:
            writer.write_block(both.pick(np.argsort(both.t_ns, kind="stable")))
        yield Case(
            f"{name}, a car's traffic", path, parse({"drive": [{"node": n} for n in (1, 2, 3)]})
        )


def drawn(case: Case, number: int) -> Wanted | None:
    """One change of a flag, a loss or a fault if there is one; None: no flag ever changes."""
    noted = Changes()
    codec = bind(case.config.dbc_path, case.config.nodes)
    done = replay(
        OneChannel(open_log(case.path, strict=False).blocks, case.channel),
        lambda start: Gateway(case.config, codec, start),
        case.config.loop.period_ns, Briefly(lambda _out: None, noted.follow),
    )  # fmt: skip
    later = [change for change in noted.changes if change[0] > done.first_ns]
    bad = [change for change in later if change[3] in BAD] or later
    if not bad:
        return None
    t_ns, node, flag, _ = bad[np.random.default_rng(number).integers(len(bad))]
    return Wanted(FlagKind[flag.upper()], node, (t_ns - done.first_ns) / SECOND)


def row(case: Case, wanted: Wanted, folder: Path) -> tuple[str, float, float]:
    """Of the table, % of the frames that are left, and s. Raises BadLogError on other bytes."""
    began = time.perf_counter()
    codec = bind(case.config.dbc_path, case.config.nodes)
    left = shrink(case.path, case.config, codec, wanted, BEFORE_NS, case.channel)
    out = folder / "shrunk"
    shrunk_files.write_test(out, left, wanted, None, case.path)
    shrunk_files.read_back(out, left, case.config, codec)
    seconds = time.perf_counter() - began
    percent = 100.0 * left.frames.size / left.total
    size = sum(path.stat().st_size for path in out.iterdir())
    return (
        f"| {case.name} | {wanted.name}: {left.word} at {wanted.at_s:.2f} s | {left.total:,} | "
        f"{left.frames.size} | {percent:.2f} | {seconds:.1f} | {size / 1000:.0f} | yes |"
    ), percent, seconds  # fmt: skip


def given(words: list[str]) -> Iterator[Case]:
    for word in words:
        log, _, config = word.partition(":")
        yield Case(log, Path(log), prepare(Path(config) if config else None)[0])


def main(words: list[str]) -> int:
    """The table. Exit 1 where one is not shrunk to 2 % within 60 s."""
    print("| log | flag | frames | left | % | s | kB of all files | same bytes |")
    print("|---|---|---|---|---|---|---|---|")
    found = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        ours = chain(goldens(), storms(folder), among(folder), recordings(folder))
        cases = given(words) if words else ours
        if words[:1] == ["--data"]:
            cases = chain(ours, cars(Path(words[1]), folder))
        for number, case in enumerate(cases):
            wanted = drawn(case, number)
            if wanted is None:
                print(f"| {case.name} | no flag ever changes | | | | | | |", flush=True)
                continue
            text, percent, seconds = row(case, wanted, folder)
            found.append((percent, seconds))
            print(text, flush=True)
    percents, times = zip(*found, strict=True) if found else ((0.0,), (0.0,))
    print(f"\n{len(found)} logs: at most {max(percents):.2f} % (median {median(percents):.2f} %) "
          f"of the frames, at most {max(times):.1f} s")  # fmt: skip
    return int(max(percents) > 2.0 or max(times) > 60.0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
