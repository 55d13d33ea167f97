"""`evaluate`: benchmark of adhesion detectors; `evaluate thermal`: of thermal methods."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dbc.text import near
from gateway.commands import evaluate_thermal
from gateway.commands.common import GOOD, add_config, number_of_jobs
from gateway.commands.progress import Progress
from gateway.io.console import console
from gateway.io.extras import pictures
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.study.evaluation_runs import Plan

WORLDS = ("ours", "ours_held", "held", "motulator", "roller", "other")
"""The worlds of `gateway.study.worlds`, and `other` of the thermal benchmark."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("what", nargs="?", choices=["adhesion", "thermal"], default="adhesion",
                        help="which detectors (default: adhesion)")  # fmt: skip
    parser.add_argument("--seeds", default="development", metavar="SET",
                        help="development (default), reporting, or A-B")  # fmt: skip
    parser.add_argument("--family", nargs="+", metavar="NAME",
                        help="kinds of runs, or a group: `mismatch`, `slide` (default: all kinds; "
                        "a wrong name lists them)")  # fmt: skip
    parser.add_argument("--detector", nargs="+", metavar="NAME",
                        help="detectors (default: all)")  # fmt: skip
    parser.add_argument("--dbc", metavar="FILE",
                        help="message set: traction.dbc, traction_fd.dbc or a file")  # fmt: skip
    parser.add_argument("--motor", default="bench", metavar="NAME",
                        help="bench (default) or traction_350kw; ranges scale")  # fmt: skip
    parser.add_argument("--world", choices=WORLDS, default="ours",
                        help="simulator: ours (default; the one for tuning). For adhesion: held "
                        "(constant speed at any load, with families of its own), ours_held (these "
                        "families in our simulator), motulator (that library's machines), roller "
                        "(bogies on rollers, another form of creep curve). For thermal: other "
                        "(trains of another structure, one sample a second)")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="DIR",
                        help="folder for evaluation.md, evaluation.csv and pictures")  # fmt: skip
    parser.add_argument(
        "-j", "--jobs", type=number_of_jobs, default=1, metavar="N", help="number of processes"
    )
    parser.add_argument("--false-alarms", type=float, metavar="N",
                        help="check a stated rate of N false alarms in 1000 h instead: the limit "
                        "comes from one part of fault-free runs, and false alarms are counted in "
                        "another. Adhesion: one detector, families without a loss. Thermal: needs "
                        "--base bench")  # fmt: skip
    evaluate_thermal.arguments(parser)
    add_config(parser)


def run(options: argparse.Namespace) -> int:
    """Evaluate, print the table, write the files. Exit 2 if nothing can be evaluated."""
    if options.what == "thermal":
        return evaluate_thermal.run(options)

    if options.world == "other":
        raise ConfigError("--world other", [f"is for thermal; known: {', '.join(WORLDS[:-1])}"])
    from estimators.detect import DETECTORS
    from gateway.study.evaluation_report import table, write
    from gateway.study.evaluation_runs import Plan, evaluate, known_detectors, seeds_of

    if options.output is not None:
        pictures("--output")
    say = console()
    seeds = seeds_of(options.seeds)
    plan = Plan(
        _families(options), (), seeds, options.dbc, options.motor, options.config, options.world
    )
    if options.false_alarms is not None:
        return _promise(options, plan)
    detectors, refused = known_detectors(dict.fromkeys(options.detector or DETECTORS), plan)
    if not detectors:
        raise ConfigError("--detector", refused)
    for line in refused:
        say.print(f"left out: {line}", markup=False)
    plan = plan._replace(detectors=tuple(detectors))
    with Progress("runs", len(plan.families) * len(seeds)) as progress:

        def ended(family: str, seconds: float) -> None:
            progress.print(f"{family}: {seconds:.1f} s")

        lines = evaluate(plan, options.jobs, progress.advance, ended)
    print(table(lines))
    if options.output is not None:
        bus = options.dbc or "traction.dbc"
        title = f"Detectors, {options.seeds} seeds, {bus}, {options.motor}, world {options.world}"
        with Progress("pictures"):
            for path in write(options.output, title, lines):
                say.print(f"written: {path}", markup=False)
    return GOOD


def _promise(options: argparse.Namespace, plan: Plan) -> int:
    """Check the stated rate of false adhesion flags on `SPLITS` halves of the runs."""
    from gateway.study.adhesion_promise import measured, report, splits
    from gateway.study.evaluation_runs import known_detectors

    if not 0.001 <= options.false_alarms <= 60_000.0:
        raise ConfigError("--false-alarms", ["expected 0.001 to 60000 in 1000 h"])
    detectors, refused = known_detectors(options.detector or ["switching"], plan)
    if refused or len(detectors) != 1:
        raise ConfigError("--detector", refused or ["--false-alarms checks one detector"])
    plan = plan._replace(detectors=tuple(detectors))
    with Progress("runs", len(plan.families) * len(plan.seeds)) as progress:
        longest = measured(plan, progress.advance)
    if len(longest) < 2:
        raise ConfigError("--seeds", [f"{len(longest)} minutes in all these runs: give more"])
    print(report(splits(longest, options.false_alarms)))
    return GOOD


def _families(options: argparse.Namespace) -> tuple[str, ...]:
    """Families asked for. For a wrong name, raises ConfigError, which lists the known ones."""
    from gateway.study.worlds import WORLDS
    from sim.physics.plant import MOTORS

    world = WORLDS[options.world]
    asked = [
        one for name in options.family or world.usual for one in world.groups.get(name, (name,))
    ]
    names = tuple(dict.fromkeys(asked))
    known = ", ".join([*world.usual, *world.groups])
    problems = [
        f"no family {name!r}; there are {known}{near(name, [*world.families, *world.groups])}"
        for name in names
        if name not in world.families
    ]
    if options.motor not in MOTORS:
        meant = near(options.motor, MOTORS)
        problems.append(f"no motor {options.motor!r}; there are {', '.join(MOTORS)}{meant}")
    if problems:
        raise ConfigError("evaluate", problems)
    return names
