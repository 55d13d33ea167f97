"""`hil SCENARIO..`: scenario, gateway and expectations together."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

from gateway.commands import hil_mutate, hil_slip
from gateway.commands.common import (
    FAILED,
    GOOD,
    INCONCLUSIVE,
    add_bus,
    add_config,
    add_signature,
    names_bus,
)
from gateway.commands.progress import Progress, stepped
from gateway.hil.fitting import fitted
from gateway.io.whole_file import refuse_unwritable, whole, whole_folder
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.codec import Codec
    from gateway.hil.bench import Outcome
    from gateway.reports.reporting import Reporting
    from gateway.reports.run_report import Run
    from gateway.settings.config import Config


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("scenario", nargs="*", help="scenario files, or names of shipped ones; "
                        "--mutate: also tests for pytest")  # fmt: skip
    add_config(parser)
    add_signature(parser)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="verdicts as JUnit XML")
    parser.add_argument("-o", "--output", type=Path, metavar="LOG",
                        help="record all frames of the (last) scenario; "
                        "--slip-bench: the folder of its page")  # fmt: skip
    parser.add_argument("--results", type=Path, metavar="DIR",
                        help="folder for report.html, and a folder for each scenario")  # fmt: skip
    hil_mutate.arguments(parser)
    hil_slip.arguments(parser)
    add_bus(parser)


_ONLY_WITH = {
    "mutate_seed": "--mutate", "expect_noticed": "--mutate",
    "controller": "--slip-bench", "expect_score": "--slip-bench",
}  # fmt: skip
"""Options that mean nothing without another one. Ignored, a limit would seem to be kept."""
_UNUSED = {
    "--mutate": ("junit", "output", "results"),
    "--slip-bench": ("config", "junit", "results", "mutate"),
}
"""Options that have no effect beside another one."""


def _refuse_unused(options: argparse.Namespace) -> None:
    """Raise ConfigError for options that would have no effect."""
    given = vars(options).get("_given", set())
    kind = (
        "--slip-bench" if options.slip_bench else "--mutate" if options.mutate is not None else ""
    )
    problems = [f"{_option(key)}: only with {needed}" for key, needed in _ONLY_WITH.items()
                if key in given and needed != kind]  # fmt: skip
    problems += [
        f"{_option(key)}: not with {kind}" for key in _UNUSED.get(kind, ()) if key in given
    ]
    if problems:
        raise ConfigError("hil", problems)


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def run(options: argparse.Namespace) -> int:
    """Judge every scenario; exit 1 if any expectation failed.

    Exit 3 if expectations failed only where the machine could not keep up with the bus.
    """
    from sim.scenario import ScenarioError, builtin_names, find

    _refuse_unused(options)
    if options.slip_bench:
        return hil_slip.run(options)
    if not options.scenario:
        names = ", ".join(builtin_names())
        raise ScenarioError("hil", [f"no scenario: name one, such as `hil wet_one`, or of {names}"])
    if any(hil_mutate.is_tests(name) for name in options.scenario):
        if options.mutate is None:
            cure = "run tests with `pytest`; `hil --mutate N` runs them with faulty gateways"
            raise ScenarioError("hil", [cure])
        return hil_mutate.run_tests(options)
    scenarios = [(name, find(name)) for name in options.scenario]
    for name, scenario in scenarios:
        if not scenario.expect:
            cure = "`sim` runs a scenario without judging it"
            raise ScenarioError(name, [f"no [[expect]]: nothing would be judged; {cure}"])
    if options.mutate is not None:
        return hil_mutate.run(options, scenarios)
    if options.junit:
        refuse_unwritable(options.junit)
    with ExitStack() as results:
        return _judge_all(options, scenarios, results)


def _judge_all(
    options: argparse.Namespace, scenarios: Sequence[tuple[str, Any]], results: ExitStack
) -> int:
    """Run and judge the scenarios. results: holds the folder of the report until it is complete."""
    folder = None
    if options.results is not None:
        folder = results.enter_context(whole_folder(options.results))
    folders = _folders(folder, options.scenario)
    runs: list[Run] = []
    suites = ET.Element("testsuites")
    failed = inconclusive = 0
    for (name, scenario), inside in zip(scenarios, folders, strict=True):
        began = time.perf_counter()
        outcome, word = _one(options, name, scenario, inside, runs)
        seconds = time.perf_counter() - began
        inconclusive += outcome.inconclusive
        failed += not outcome.passed and not outcome.inconclusive
        summary = f"{seconds:.1f} s, configuration {word:06x}"
        bad = "??  " if outcome.inconclusive else "FAIL"
        print(f"{'ok  ' if outcome.passed else bad} {scenario.title}  ({summary})")
        for v in outcome.verdicts:
            print(f"     {'ok  ' if v.passed else bad} {v.text}: {v.detail}")
        if outcome.inconclusive:
            print(f"     inconclusive, this machine could not keep up: {outcome.overload}")
        _suite(suites, scenario.title, outcome, seconds, word)
    if options.junit:
        with whole(options.junit) as part:
            ET.ElementTree(suites).write(part, encoding="utf-8", xml_declaration=True)
    if folder is not None:
        from gateway.reports.reporting import leave

        title = runs[0].title if len(runs) == 1 else f"HIL: {len(runs)} scenarios"
        report = leave(folder, title, runs, single=len(runs) == 1)
        results.close()
        print(f"report: {options.results / report.name}")
    return FAILED if failed else INCONCLUSIVE if inconclusive else GOOD


def _folders(results: Path | None, names: Sequence[str]) -> list[Path | None]:
    """A folder for each scenario; repeated names are numbered."""
    if results is None:
        return [None] * len(names)
    results.mkdir(parents=True, exist_ok=True)
    given: list[str] = []
    for name in names:
        stem, count = Path(name).stem, 1
        while (own := stem if count == 1 else f"{stem}-{count}") in given:
            count += 1
        given.append(own)
    return [results / own for own in given]


def _one(
    options: argparse.Namespace, name: str, scenario: Any, folder: Path | None, runs: list[Run]
) -> tuple[Outcome, int]:
    """Verdicts, and the configuration's hash on the bus; adds the run to `runs` for a report."""
    scenario, config, codec = fitted(options.config, scenario, options)
    if folder is None:
        outcome = _outcome(options, name, scenario, config, codec)
    else:
        from gateway.reports.reporting import Reporting

        with Reporting(folder, config, codec) as left:
            outcome = _outcome(options, name, scenario, config, codec, left)
        runs.append(_kept(options, name, scenario, left, outcome))
    return outcome, outcome.gateway.outbox.config_hash


def _kept(
    options: argparse.Namespace, name: str, scenario: Any, left: Reporting, outcome: Outcome
) -> Run:
    """Report of one scenario."""
    from gateway.commands.run import options_name
    from gateway.reports.reporting import file_facts, span_facts
    from sim.scenario import path_of

    facts = [
        *file_facts(path_of(name), "scenario"),
        ("seed", str(scenario.seed)),
        ("bus", options_name(options) if names_bus(options) else "none: a virtual clock"),
        *span_facts(left.trace, outcome.gateway.inbox.counts["received"]),
    ]
    inside = f"{left.folder.name}/"
    overload = outcome.overload if outcome.inconclusive else ""
    with Progress("report", len(left.trace.nodes) + 1) as progress:
        return left.run(
            scenario.title, facts, inside=inside, verdicts=outcome.verdicts, overload=overload,
            step=stepped(progress),
        )  # fmt: skip


def _outcome(
    options: argparse.Namespace,
    name: str,
    scenario: Any,
    config: Config,
    codec: Codec,
    left: Reporting | None = None,
) -> Outcome:
    if names_bus(options):
        from gateway.hil.buses import run_on_real_bus
        from gateway.hil.own_motor import save_scenario
        from sim.scenario import find

        with ExitStack() as stack:
            if scenario != find(name):
                # The drives' process reads its scenario from a file.
                here = stack.enter_context(TemporaryDirectory(prefix="hil-"))
                name = str(Path(here) / "scenario.toml")
                save_scenario(scenario, Path(name))
            bar = Progress(scenario.title, scenario.duration_s, by_itself=False)
            progress = stack.enter_context(bar).to
            return run_on_real_bus(options, name, scenario, config, codec, left, progress=progress)
    from gateway.hil.bench import run_virtual

    key = None
    if config.authentication is not None:
        from gateway.io.credentials import flag_key

        key = flag_key(config.authentication.key, config.base)
    with ExitStack() as stack:
        watch = stack.enter_context(_progress(scenario))
        if options.output is not None:
            watch.append(stack.enter_context(_recording(options.output, paired=key is not None)))
        return run_virtual(scenario, config, codec, watch, key, left)


@contextmanager
def _recording(path: Path, *, paired: bool) -> Iterator[Any]:
    """Yield a watcher that writes all frames. paired: each Auth frame follows its flag frame."""
    from dbc.candump.writer import Writer

    def record(_now: int, received: list[Any], sent: list[Any], _gateway: Any) -> None:
        ours = sent if paired else sorted(sent)
        for frame in sorted([*received, *ours], key=lambda frame: frame.t_ns):
            writer.write(frame._replace(channel="vcan0"))

    with whole(path) as part, Writer(part) as writer:
        yield record


@contextmanager
def _progress(scenario: Any) -> Iterator[list[Any]]:
    """Yield a watcher that shows a bar over the scenario's time."""
    with Progress(scenario.title, scenario.duration_s) as progress:

        def look(now: int, *_: Any) -> None:
            if now % 500_000_000 == 0:
                progress.to(now / 1e9)

        yield [look]


def _suite(parent: ET.Element, title: str, outcome: Outcome, seconds: float, word: int) -> None:
    """Add a scenario to the JUnit XML; a failure on an overloaded machine counts as an error.

    A repeated title gets the scenario's number: GitLab keeps one of several cases of a name.
    """
    verdicts = outcome.verdicts
    if title in [suite.get("name") for suite in parent]:
        title = f"{title} ({len(parent) + 1})"
    kind = "error" if outcome.inconclusive else "failure"
    suite = ET.SubElement(
        parent, "testsuite", name=title, tests=str(len(verdicts)), failures="0", errors="0",
        time=f"{seconds:.3f}",
    )  # fmt: skip
    suite.set(f"{kind}s", str(sum(not v.passed for v in verdicts)))
    properties = ET.SubElement(suite, "properties")
    ET.SubElement(properties, "property", name="config_hash", value=f"{word:06x}")
    for v in verdicts:
        case = ET.SubElement(suite, "testcase", classname=title, name=v.text)
        if v.passed:
            ET.SubElement(case, "system-out").text = v.detail
        else:
            why = f"inconclusive ({outcome.overload}): " if outcome.inconclusive else ""
            ET.SubElement(case, kind, message=f"{why}{v.detail}")
