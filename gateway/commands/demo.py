"""`demo`: drives and gateway on a bus inside the program; nothing else has to be installed."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from gateway.commands.common import GOOD, add_duration
from gateway.commands.progress import Progress
from gateway.io import extras
from gateway.io.console import console
from gateway.io.prepare import prepare
from gateway.settings.config import ConfigError

CHANNEL = "traction-gateway-demo"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("--headless", action="store_true", help="no live display")
    add_duration(parser)
    parser.add_argument("--scenario", default="demo", help="a scenario file or shipped name")
    parser.add_argument("-o", "--output", type=Path, default=Path("demo.png"), metavar="PNG",
                        help="where the picture goes (default: demo.png)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Run drives and gateway over a real python-can bus, in one loop and in real time."""
    from gateway.hil.demo import rehearse, run_demo
    from gateway.hil.fitting import scenario_thermal
    from gateway.io.whole_file import refuse_unwritable
    from gateway.reports.figures import Span, loads
    from gateway.reports.intervals import Intervals
    from gateway.reports.scoring import judge, summary_table
    from gateway.reports.ticks import TickLog
    from gateway.reports.trace import Trace
    from gateway.reports.truth import Truth
    from gateway.settings.sections import Drive
    from sim.scenario import find

    refuse_unwritable(options.output)
    scenario = find(options.scenario)
    config, codec = prepare(None, thermal=scenario_thermal())
    drives = tuple(Drive(node=n) for n in scenario.nodes)
    config = config.model_copy(update={"drive": drives})
    intervals, trace = Intervals(config.nodes), Trace(config.nodes)
    ticks = TickLog((intervals.add_ticks, trace.add_ticks))
    seconds = scenario.duration_s if options.duration is None else options.duration
    say = console()
    say.print(f"{scenario.title}: {scenario.drives} drives, {seconds:g} s", markup=False)
    live = None
    if not options.headless and sys.stderr.isatty():
        from rich.live import Live

        live = Live(console=say, auto_refresh=True, refresh_per_second=8)

    def watch(tick: int, gateway: Any) -> None:
        ticks.append(gateway)
        if live is not None and tick % 10 == 0:
            from gateway.reports.live_table import render

            live.update(
                render(
                    gateway.view,
                    f"{scenario.title}   t = {tick / config.loop.rate_hz:.1f} of {seconds:g} s",
                )
            )

    rehearse(scenario, config, codec)
    with live or nullcontext():
        done = run_demo(scenario, config, codec, CHANNEL, seconds, watch, options.began_s)
    known = Truth()
    known.add_rows(done.truth)
    known.close()
    ticks.flush()
    intervals.close()
    losses = [event for event in known.events if event.flag == "adhesion"]
    print(summary_table(judge(losses, intervals.kept, 0)[0], config.nodes))
    print(
        f"first flag {done.first_flag_s:.2f} s after the program started; "
        f"ran at {done.pace:.2f} of real time; "
        f"frames received {done.gateway.inbox.counts['received']}, "
        f"rejected {done.gateway.view.rejected if done.gateway.view else 0}"
    )
    try:
        extras.pictures("no picture")
    except ConfigError as error:
        say.print(str(error), markup=False, soft_wrap=True)
        return GOOD
    options.output.parent.mkdir(parents=True, exist_ok=True)
    spans = [Span(loss.start_s, loss.end_s, loss.node, "lost") for loss in losses]
    with Progress("picture"):
        loads(options.output, trace, scenario.title, known, spans)
    print(f"picture: {options.output}")
    return GOOD
