"""`reproduce adhesion|thermal -o DIR`: tables and figures of the two papers.

Paper `adhesion`: section 5, Table 1 and Figures 5-9; `thermal`: see `reproduce_thermal`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.commands.common import GOOD
from gateway.commands.progress import Progress, stepped
from gateway.io.console import console
from gateway.io.extras import need, pictures
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.study.reproduction_report import Outcome
    from sim.scenario import Scenario

STANDING_SEEDS: Final = tuple(range(5, 105))


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("paper", choices=["adhesion", "thermal"], help="which paper")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", required=True,
                        help="folder for tables, figures, logs and report")  # fmt: skip
    parser.add_argument("--seed", type=_seed, metavar="N",
                        help="adhesion: seed of noise and start angles")  # fmt: skip
    parser.add_argument("--resume", action="store_true",
                        help="thermal: continue the stopped run of this folder")  # fmt: skip


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a seed: expected 0, 1, 2 ..")
    return int(text)


def run(options: argparse.Namespace) -> int:
    """Reproduce the paper; print its table beside ours."""
    pictures("reproduce")
    if options.paper == "thermal":
        return _thermal(options.output, resume=options.resume)
    if options.resume:
        raise ConfigError("--resume", ["is for `reproduce thermal`"])
    from gateway.commands import section5
    from gateway.study.reproduction import agreement
    from gateway.study.reproduction_text import table_text
    from sim.scenario import builtin

    began = time.perf_counter()
    scenario = builtin(section5.NAME)
    if options.seed is not None:
        scenario = scenario.model_copy(update={"seed": options.seed})
    outcome = reproduce(scenario, options.output)
    print(table_text(outcome.cells))
    print(agreement(outcome.cells))
    print(f"report: {options.output / 'report.html'}")
    console().print(f"done in {time.perf_counter() - began:.0f} s")
    return GOOD


def _thermal(folder: Path, *, resume: bool) -> int:
    need(("autograd", "pywt", "sklearn"), "papers")
    from gateway.commands import reproduce_thermal as thermal

    show = partial(print, flush=True)  # not buffered, because the rest takes minutes
    began = time.perf_counter()
    with Progress("starting", 2 * thermal.TRAINS + thermal.STEPS) as progress:
        thermal.reproduce(folder, stepped(progress), resume=resume, show=show)
    print(f"report: {folder / 'report.html'}")
    console().print(f"done in {time.perf_counter() - began:.0f} s")
    return GOOD


def reproduce(scenario: Scenario, folder: Path, seeds: Sequence[int] = STANDING_SEEDS) -> Outcome:
    """Write everything into `folder`. The same scenario gives the same tables byte by byte.

    `seeds`: of the standing starts. Raises OSError if `folder` cannot be written.
    """
    import numpy as np

    from gateway.commands import section5
    from gateway.study import reproduction as table_1
    from gateway.study import reproduction_figures as figures
    from gateway.study import reproduction_loads as bench
    from gateway.study import reproduction_paths as paths
    from gateway.study import reproduction_report as report
    from gateway.study import reproduction_variants as variants

    folder.mkdir(parents=True, exist_ok=True)
    with Progress("starting", 6 + len(section5.BUSES) + len(table_1.METHODS)) as progress:
        step = stepped(progress)
        step("three drives at 8 kHz")
        world = section5.simulate(scenario)
        step("filters without a bus")
        full = section5.measure(world, 1, 2, (0.0, 0.0))
        main = bench.estimate(full, bench.PAPER, *bench.unit_start(world.start))
        zero = bench.estimate(full, bench.PAPER, *bench.unit_start(np.zeros_like(world.start)))
        courses = section5.without_bus(world)
        for bus in section5.BUSES:
            step(f"{bus.way}: frames into a log, gateway over it")
            log = folder / bus.log
            section5.write_log(scenario, bus, log)
            courses += [section5.replay_log(log, bus, b) for b in (bench.PAPER, bench.PRODUCT)]
        step("standing starts")
        starts = [section5.standing_start(scenario, seed) for seed in seeds]
        step("networks without a central unit")
        networks = variants.networks_of(main.load)
        step("tables")
        zero_locked = section5.locked(zero.speed, world)
        outcome = report.Outcome(
            seed=scenario.seed,
            duration_s=scenario.duration_s,
            cells=table_1.compare(
                table_1.table(main.load), table_1.table(zero.load), zero_locked=all(zero_locked)
            ),
            rmse=bench.rmse(main.load, world.load),
            comparison=paths.compare(courses, paths.Course("truth", "", world.t_ns, world.load)),
            zero_locked=zero_locked,
            starts=starts,
            strengths=table_1.prior_strengths(main.load),
            variants=variants.variants(main.load, main.speed),
            networks=networks,
        )
        table_1.write_table(folder / "table1.csv", outcome.cells)
        paths.write_paths(folder / "table1_paths.csv", outcome.comparison)
        picture = figures.Picture(world.t_s, world.load, main.load, section5.spans(scenario))
        for number, method in enumerate(table_1.METHODS, 5):
            step(f"figure {number}")
            figures.loads(folder / f"figure{number}", picture, method)
        step("figure 9 and report")
        figures.histograms(folder / "figure9", picture)
        report.write(folder, outcome)
    return outcome
