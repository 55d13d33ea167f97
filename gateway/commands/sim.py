"""`sim SCENARIO`: the simulated inverter ECUs, on a bus or straight into a log."""

from __future__ import annotations

import argparse
import csv
import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from gateway.commands.common import GOOD, add_bus, add_config, add_duration, names_bus
from gateway.commands.progress import track
from gateway.io.console import console
from gateway.io.whole_file import whole
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.secoc_receiver import Verifier

log = logging.getLogger(__name__)


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("scenario", help="a scenario file, or the name of a shipped one")
    parser.add_argument("-o", "--output", type=Path, metavar="LOG",
                        help="write a candump log, faster than real time")  # fmt: skip
    parser.add_argument("--truth", type=Path, metavar="FILE", help="CSV file for the ground truth")
    add_duration(parser)
    add_config(parser)
    parser.add_argument("--dbc", metavar="FILE",
                        help="message set: traction.dbc, traction_fd.dbc or a file "
                        "(default: the configuration's, else traction.dbc)")  # fmt: skip
    parser.add_argument("--wait-for-start", action="store_true",
                        help="stay pre-operational until an NMT master starts them")  # fmt: skip
    parser.add_argument("--auth-key", type=Path, metavar="FILE",
                        help="obey only flags authenticated with this key")  # fmt: skip
    parser.add_argument(
        "--auth-after", type=int, default=0, metavar="FRESHNESS",
        help="reject flags with a freshness up to this: that of the last flag of an earlier run",
    )  # fmt: skip
    add_bus(parser)


def run(options: argparse.Namespace) -> int:
    """Simulate. Without a bus and without -o, the log goes to stdout."""
    from dbc.codec import bind
    from gateway.hil.fitting import fitted
    from gateway.settings.config import BUILTIN_DBC, shipped_dbc
    from sim.scenario import find
    from sim.simulation import Simulation

    scenario = find(options.scenario)
    if options.config is not None:
        scenario, _, codec = fitted(options.config, scenario)
    if options.config is None or options.dbc is not None:
        path = Path(options.dbc or "traction.dbc")
        if str(path) in BUILTIN_DBC and not path.is_file():
            path = shipped_dbc(str(path))
        codec = bind(path, tuple(scenario.nodes))
    on_bus = names_bus(options)
    if on_bus:
        # One step imports everything before the clock starts: real time does not wait for it.
        Simulation(scenario, codec).step((), 250_000_000)
    simulation = Simulation(
        scenario, codec, self_start=not options.wait_for_start, verifier=_verifier(options)
    )  # fmt: skip
    seconds = scenario.duration_s if options.duration is None else options.duration
    # A run on a bus cannot be repeated, so its truth is kept even if a signal ends the run.
    with _truth(options.truth, keep=on_bus) as truth:
        if on_bus:
            _on_bus(options, simulation, seconds, truth)
        else:
            _into_log(options, simulation, seconds, truth)
    return GOOD


def _verifier(options: argparse.Namespace) -> Callable[[], Verifier] | None:
    """Factory of a drive's receiver of authenticated flags. Raises ConfigError for a bad key."""
    if options.auth_key is None:
        return None
    from dbc.secoc_receiver import Verifier
    from gateway.io.credentials import flag_key

    if not 0 <= options.auth_after < 1 << 64:
        raise ConfigError("--auth-after", ["a freshness has 64 bits"])
    return partial(Verifier, flag_key(str(options.auth_key), Path()), options.auth_after)


class _Truth:
    """The truth file; without one, rows are taken out of the simulation and dropped."""

    def __init__(self, file: TextIO | None) -> None:
        self._writer = csv.writer(file, lineterminator="\n") if file else None
        if self._writer:
            from sim.ground_truth import COLUMNS

            self._writer.writerow(COLUMNS)

    def record(self, simulation: Any) -> None:
        rows = simulation.truth_rows()
        if self._writer:
            self._writer.writerows(row.text() for row in rows)


@contextmanager
def _truth(path: Path | None, *, keep: bool) -> Iterator[_Truth]:
    """Yield the truth file; it gets its name when complete. keep: see `whole`."""
    if path is None:
        yield _Truth(None)
        return
    with whole(path, keep=keep) as part, part.open("w", newline="", encoding="utf-8") as file:
        yield _Truth(file)


def _into_log(options: argparse.Namespace, simulation: Any, seconds: float, truth: _Truth) -> None:
    from dbc.candump.writer import Writer

    step = 10_000_000
    with ExitStack() as stack:
        target = stack.enter_context(whole(options.output)) if options.output else None
        writer = stack.enter_context(Writer(target or sys.stdout.buffer))
        ticks = round(seconds * 100) + 1
        for tick in track(range(ticks), "simulating", ticks):
            for frame in simulation.step((), tick * step):
                writer.write(frame._replace(channel="vcan0"))
            truth.record(simulation)


def _on_bus(options: argparse.Namespace, simulation: Any, seconds: float, truth: _Truth) -> None:
    from gateway.hil.simbus import run_on_bus
    from gateway.io.bus import open_present
    from gateway.io.live import Stop
    from gateway.io.permission import drives_only

    transport = open_present(options, drives_only(simulation.codec, simulation.nodes))
    console().print(
        f"{simulation.scenario.title}: {simulation.scenario.drives} drives for {seconds:g} s",
        markup=False,
    )

    def after_step() -> None:
        truth.record(simulation)
        _say_failures(simulation)

    stop = Stop()
    overwritten = run_on_bus(simulation, transport, seconds, after_step, stop)
    for node, verifier in simulation.verifiers.items():
        print(
            f"drive {node}: {verifier.accepted} flags genuine, {verifier.failed} failed, "
            f"{verifier.alone} without a flag, last freshness {verifier.freshness}"
        )
    if overwritten:
        console().print(f"{overwritten} frames became too old to be sent: this machine stalled")
    if stop.ended is not None:
        raise stop.ended


def _say_failures(simulation: Any) -> None:
    """Log what a receiver could not verify, at most once a second for each drive."""
    for node, verifier in simulation.verifiers.items():
        if notice := verifier.notice(time.monotonic_ns()):
            log.warning("drive %d: %s", node, notice)
