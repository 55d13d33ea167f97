"""`evaluate thermal`: the benchmark of thermal methods on labelled trains by seed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.text import near
from gateway.commands.common import GOOD
from gateway.commands.progress import Progress, track
from gateway.io.console import console
from gateway.io.whole_file import write_text
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.study.thermal_trials import Trial

NOTE: Final = """\
Each sample is scored against the injection interval; graced rates leave out the onset until the
true effect passes 2 K, and the recovery until it is below 1 K. All methods have the same rule for
their limit: the 99 % quantile of the method's statistic on a fault-free run that it was not fitted
on; best: the limit that would have been best in hindsight. Kind `none` is fault-free. Delay
(median), motor and class are those of the faults that were found. Last column: seconds to score one
record."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options that only the thermal benchmark has."""
    group = parser.add_argument_group("thermal")
    group.add_argument("--base", choices=["days", "bench"], default="days",
                       help="samples hours apart (default), or one a second")  # fmt: skip
    group.add_argument("--kind", nargs="+", metavar="NAME",
                       help="kinds of faults, `none` for fault-free (default: all except "
                       "`sensor_creep`)")  # fmt: skip
    group.add_argument("--method", nargs="+", metavar="NAME", help="methods (default: all)")
    group.add_argument("--limit-hours", type=float, default=4.0, metavar="H",
                       help="for --false-alarms: hours for the limit (default: 4)")  # fmt: skip
    group.add_argument("--judged-hours", type=float, default=50.0, metavar="H",
                       help="for --false-alarms: hours in which they are counted "
                       "(default: 50)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Evaluate, print the table, write it if asked for. Exit 2 if nothing can be evaluated."""
    with Progress("loading the methods"):
        from gateway.study.evaluation_runs import seeds_of
        from gateway.study.thermal_dataset import CREEP, KINDS
        from gateway.study.thermal_scores import COLUMNS, cells, table_of
        from gateway.study.thermal_trials import (
            DEVELOPMENT,
            HEALTHY,
            NAMES,
            REPORTING,
            WORLDS,
            evaluate,
        )

    if options.world not in WORLDS:
        known = ", ".join(WORLDS)
        raise ConfigError(f"--world {options.world}", [f"is for adhesion; known: {known}"])
    for option, needs in (
        ("--world other", options.world == "other"),
        ("--false-alarms", options.false_alarms is not None),
    ):
        if needs and options.base != "bench":
            raise ConfigError(option, ["is for samples of seconds only: add --base bench"])
    seeds = seeds_of(options.seeds, DEVELOPMENT, REPORTING)
    if options.false_alarms is not None:
        return _promise(options, seeds)
    usual = (*KINDS, HEALTHY)
    kinds = _known("kind", options.kind or usual, (*usual, CREEP))
    methods = _known("method", options.method, NAMES)
    say = console()
    found = []
    each = evaluate(seeds, options.base, kinds, methods, options.jobs, options.world)
    for rows in track(each, "trains", len(seeds)):
        found += rows
    lines = []
    for kind in (*kinds, *(["all"] if len(kinds) > 1 else [])):
        for method in methods:
            own = [t.score for t in found if t.method == method and kind in (t.kind, "all")]
            if own:
                lines.append(cells(method, kind, own))
    left_out = [method for method in methods if not any(t.method == method for t in found)]
    text = "\n\n".join([table_of(COLUMNS, lines), *_more(found, kinds, methods)])
    print(text)
    for method in left_out:
        say.print(f"left out: {method}: its library is not installed", markup=False)
    if options.output is not None:
        title = (
            f"# Thermal methods, {options.seeds} seeds, {options.base} base, {options.world} world"
        )
        missing = "".join(f"\n\n{method}: its library is not installed." for method in left_out)
        folder: Path = options.output
        path = folder / "evaluation.md"
        write_text(path, f"{title}\n\n{text}\n\n{NOTE}{missing}\n")
        say.print(f"written: {path}", markup=False)
    return GOOD


def _promise(options: argparse.Namespace, seeds: Sequence[int]) -> int:
    from gateway.study.thermal_promise import RUN_H, Split, report, splits

    if not 0.001 <= options.false_alarms <= 1000.0:
        raise ConfigError("--false-alarms", ["expected 0.001 to 1000 in 1000 h"])
    if options.kind or options.method:
        raise ConfigError("--false-alarms", ["takes no --kind, --method"])
    how = Split(options.false_alarms, options.limit_hours, options.judged_hours)
    if not all(RUN_H <= hours < 1e6 for hours in how[1:]):
        problem = f"expected {RUN_H:g} h, which a run has, or more"
        raise ConfigError("--limit-hours, --judged-hours", [problem])
    each = splits(seeds, options.world, how, options.jobs)
    found = [kept for kept in track(each, "trains", len(seeds)) if kept is not None]
    if not found:
        raise ConfigError("--seeds", ["these trains have one motor each, which is never judged"])
    text = report(found)
    print(text)
    if options.output is not None:
        title = f"# Stated rate of false alarms, {options.seeds} seeds, {options.world} world"
        write_text(options.output / "promise.md", f"{title}\n\n{text}\n")
    return GOOD


def _more(found: Sequence[Trial], kinds: Sequence[str], methods: Sequence[str]) -> Iterator[str]:
    """Tables of confusions and of false alarms a month, as far as the chosen kinds allow."""
    from gateway.study.thermal_dataset import KINDS
    from gateway.study.thermal_scores import mean, table_of
    from gateway.study.thermal_trials import HEALTHY, UNDECIDED, confused

    faults = [kind for kind in kinds if kind != HEALTHY]
    columns = (*KINDS, UNDECIDED)
    naming = [m for m in methods if any(t.named for t in found if t.method == m)]
    for method in naming:
        rows = []
        for kind in faults:
            counts = [t.named for t in found if t.method == method and t.kind == kind]
            total = sum(sum(names.values()) for names in counts)
            shares = [sum(names.get(k, 0) for names in counts) / max(total, 1) for k in columns]
            rows.append([kind, *(f"{100.0 * share:.0f}" for share in shares)])
        head = [f"{method}: true fault; named as, %", *columns]
        yield table_of(head, rows)
        own = [t for t in found if t.method == method]
        parts = {method: own} | {kind: [t for t in own if t.kind == kind] for kind in faults}
        rows = [
            [of, *(f"{100.0 * share:.1f}" for share in confused(part))]
            for of, part in parts.items()
        ]
        yield table_of(["heat or sensor", "confused, % of named", "undecided %"], rows)
    if HEALTHY in kinds:
        rows = [
            [m, f"{30.0 * mean(scores).episodes:.1f}", f"{100.0 * mean(scores).fpr:.2f}"]
            for m in methods
            if (scores := [t.score for t in found if t.method == m and t.kind == HEALTHY])
        ]
        yield table_of(["fault-free", "false alarms of a train in 30 days", "% of the time"], rows)


def _known(what: str, asked: Sequence[str] | None, known: tuple[str, ...]) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(asked or known))
    unknown = [name for name in names if name not in known]
    if unknown:
        lines = [
            f"no {what} {name!r}; there are {', '.join(known)}{near(name, known)}"
            for name in unknown
        ]
        raise ConfigError(f"--{what}", lines)
    return names
