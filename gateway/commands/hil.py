"""`hil SCENARIO..`: scenario, gateway and expectations together."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

from gateway.commands.common import (
    FAILED,
    GOOD,
    add_bus,
    add_config,
    add_signature,
    console,
    fitting,
    out_file,
)

if TYPE_CHECKING:
    from gateway.drivers.bench import Outcome

HELP = "run scenarios against the gateway and judge their expectations"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("scenario", nargs="+", help="scenario files, or names of shipped ones")
    add_config(parser)
    add_signature(parser)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="verdicts as JUnit XML")
    parser.add_argument("-o", "--output", type=Path, metavar="LOG",
                        help="record all frames of the (last) scenario")  # fmt: skip
    parser.add_argument("--results", type=Path, metavar="DIR",
                        help="report of the timing on a bus, a folder per scenario")  # fmt: skip
    add_bus(parser)


def run(options: argparse.Namespace) -> int:
    """Judge every scenario; exit 1 if any expectation failed."""
    from sim.scenario import find

    scenarios = [(name, find(name)) for name in options.scenario]
    suites = ET.Element("testsuites")
    failed = 0
    for name, scenario in scenarios:
        began = time.perf_counter()
        verdicts, word = _one(options, name, scenario)
        seconds = time.perf_counter() - began
        bad = [v for v in verdicts if not v.passed]
        failed += len(bad)
        said = f"{seconds:.1f} s, configuration {word:06x}"
        print(f"{'FAIL' if bad else 'ok  '} {scenario.title}  ({said})")
        for v in verdicts:
            print(f"     {'ok  ' if v.passed else 'FAIL'} {v.text}: {v.detail}")
        _suite(suites, scenario.title, verdicts, seconds, word)
    if options.junit:
        path = options.junit
        path.parent.mkdir(parents=True, exist_ok=True)
        ET.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)
    return FAILED if failed else GOOD


def _one(options: argparse.Namespace, name: str, scenario: Any) -> tuple[list[Any], int]:
    """Verdicts, and what the configuration is called on the bus."""
    outcome = _outcome(options, name, scenario)
    return outcome.verdicts, outcome.gateway.outbox.config_hash


def _outcome(options: argparse.Namespace, name: str, scenario: Any) -> Outcome:
    config, codec = fitting(options.config, scenario, options)
    if hasattr(options, "interface") or hasattr(options, "channel"):
        from gateway.drivers.hilbus import run_on_real_bus

        folder = options.results / Path(name).stem if options.results else None
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        return run_on_real_bus(options, name, scenario, config, codec, folder)
    from gateway.drivers.bench import run_virtual

    if options.results:
        from gateway.config import ConfigError

        raise ConfigError("--results", ["the virtual clock is never late; name a bus (-i, -c)"])
    key = None
    if config.authentication is not None:
        from gateway.drivers.credentials import flag_key

        key = flag_key(config.authentication.key, config.base)
    if options.output is None:
        with _progress(scenario) as watch:
            return run_virtual(scenario, config, codec, watch, key=key)
    from dbc.candump import Writer

    writer = Writer(out_file(options.output))

    def record(_now: int, received: list[Any], sent: list[Any], _view: Any) -> None:
        # Each Auth frame stays behind its flag frame, which it would not by its identifier.
        ours = sent if key else sorted(sent)
        for frame in sorted([*received, *ours], key=lambda frame: frame.t_ns):
            writer.write(frame._replace(channel="vcan0"))

    try:
        with _progress(scenario) as watch:
            return run_virtual(scenario, config, codec, [record, *watch], key=key)
    finally:
        writer.close()


@contextmanager
def _progress(scenario: Any) -> Iterator[list[Any]]:
    """A bar over the scenario's time, if a person is watching."""
    if not sys.stderr.isatty():
        yield []
        return
    from rich.progress import Progress

    with Progress(console=console(), transient=True) as progress:
        task = progress.add_task(scenario.title, total=scenario.duration_s)

        def look(now: int, *_: Any) -> None:
            if now % 500_000_000 == 0:
                progress.update(task, completed=now / 1e9)

        yield [look]


def _suite(parent: ET.Element, title: str, verdicts: list[Any], seconds: float, word: int) -> None:
    suite = ET.SubElement(
        parent, "testsuite", name=title, tests=str(len(verdicts)),
        failures=str(sum(not v.passed for v in verdicts)), time=f"{seconds:.3f}",
    )  # fmt: skip
    properties = ET.SubElement(suite, "properties")
    ET.SubElement(properties, "property", name="config_hash", value=f"{word:06x}")
    for v in verdicts:
        case = ET.SubElement(suite, "testcase", classname=title, name=v.text)
        if v.passed:
            ET.SubElement(case, "system-out").text = v.detail
        else:
            ET.SubElement(case, "failure", message=v.detail)
