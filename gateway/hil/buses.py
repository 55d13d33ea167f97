"""A scenario on a real bus: the drives in a process of their own, the gateway in this one."""

from __future__ import annotations

import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dbc.codec import Codec
from dbc.frame import MS, SECOND, Nanos
from gateway.core.gateway import Gateway
from gateway.hil.bench import Outcome, touched_drives
from gateway.io.bus import open_present
from gateway.io.canopen_node import CanopenNode
from gateway.io.credentials import flag_authenticator, private_file
from gateway.io.live import LiveSnapshot, Stop, run_live
from gateway.io.permission import Mode, allowed
from gateway.io.realtime import Ticker
from gateway.reports.expectations import FlagTrack, judge
from gateway.settings.config import Config
from sim.scenario import Scenario

if TYPE_CHECKING:
    from gateway.reports.reporting import Reporting

TRUTH = "truth.csv"
"""File of the ground truth, among the results."""
ON_THE_WIRE = ("silent", "frame_loss", "corrupt")
"""Events that by themselves make a drive's samples late or lost."""
MOST_LATE_NS: Nanos = 5 * MS
"""Largest lateness of samples, usual or current, on a machine that keeps up: half a tick."""


class Overload:
    """Evidence, gathered tick by tick, that gateway or drives did not get enough processor time.

    A failed expectation is then inconclusive.
    """

    def __init__(self, scenario: Scenario, tick_ns: Nanos) -> None:
        """Check the drives' samples for lateness, unless the scenario itself delays them."""
        self._tick_ns = tick_ns
        self._drives = not any(event.kind in ON_THE_WIRE for event in scenario.event)
        self._missed_before: int | None = None
        self._missed = 0
        self._late_ns = 0

    def look(self, gateway: Gateway, seen: LiveSnapshot) -> None:
        """Take one tick in which the drives are on the bus."""
        if self._missed_before is None:
            self._missed_before = seen.missed
        self._missed = seen.missed - self._missed_before
        if self._drives:
            drives = gateway.inbox.receiver.drives
            sampled = drives[drives["sample_ns"] >= 0]
            # At its end, samples may be up to a tick old; older means that newer ones are overdue.
            away_ns = seen.now_ns - sampled["sample_ns"] - self._tick_ns
            late_ns = np.maximum(sampled["clock"]["usual_ns"], away_ns)
            self._late_ns = max(self._late_ns, int(late_ns.max(initial=0)))

    def __str__(self) -> str:
        """The evidence in words; empty if the machine kept up."""
        found = []
        if self._missed:
            found.append(f"the gateway missed {self._missed} ticks")
        if self._late_ns > MOST_LATE_NS:
            found.append(f"the drives' samples came up to {self._late_ns / MS:.0f} ms late")
        return " and ".join(found)


def bus_arguments(options: Namespace) -> list[str]:
    """The bus options of this command line, for that of a child process."""
    words: list[str] = []
    for key, flag in (("interface", "-i"), ("channel", "-c"), ("bitrate", "-b"),
                      ("data_bitrate", "--data-bitrate")):  # fmt: skip
        if getattr(options, key, None) is not None:
            words += [flag, str(getattr(options, key))]
    return [*words, "--fd"] if getattr(options, "fd", False) else words


def _authentication(config: Config, gateway: Gateway) -> list[str]:
    """Options with which the drives verify the gateway's flags; the key is named by its file."""
    sender = gateway.outbox.authenticator
    if config.authentication is None or sender is None:
        return []
    path, _ = private_file(config.authentication.key, config.base)
    return ["--auth-key", str(path), "--auth-after", str(sender.freshness)]


class _Run:
    """What is recorded of a scenario on a bus, tick by tick, from the first frame to its end."""

    def __init__(
        self,
        scenario: Scenario,
        gateway: Gateway,
        track: FlagTrack,
        left: Reporting | None,
        progress: Callable[[float], None],
    ) -> None:
        """For `left` and `progress` see `run_on_real_bus`."""
        self.start_ns: Nanos | None = None
        """The first frame received."""
        self.overload = Overload(scenario, gateway.config.loop.period_ns)
        self._gateway = gateway
        self._track = track
        self._left = left
        self._progress = progress
        self._duration_ns = round(scenario.duration_s * SECOND)
        self._shown_s = 0

    def observe(self, seen: LiveSnapshot) -> None:
        """Take one tick. Flags count from the first tick on, the rest from the first frame."""
        if self.start_ns is None and seen.status.received:
            self.start_ns = seen.now_ns
        if self.start_ns is None:
            self._track.store(seen.sent)
            return
        elapsed_ns = seen.now_ns - self.start_ns
        if elapsed_ns <= self._duration_ns:
            self._track.store(seen.sent)
            self.overload.look(self._gateway, seen)
            if self._left is not None and self._gateway.view is not None:
                self._left.add_tick()
        if elapsed_ns >= self._shown_s * SECOND:
            self._progress(self._shown_s)
            self._shown_s += 1


def run_on_real_bus(
    options: Namespace,
    name: str,
    scenario: Scenario,
    config: Config,
    codec: Codec,
    left: Reporting | None = None,
    *,
    progress: Callable[[float], None],
) -> Outcome:
    """Run in real time until the drives' process ends. Raises `Ended` if a signal came first.

    Scenario time starts with the first frame received; flags sent after its end, when the drives
    stop, are not evaluated. left: records the run for a report; the drives' process writes the
    ground truth, on its own clock, into its folder. progress: called once a second, with the
    scenario's time in s.
    """
    ticker = Ticker(config.loop.period_ns)
    gateway = Gateway(config, codec, ticker.clock(), flag_authenticator(config))
    transport = open_present(options, allowed(Mode.HIL, config, codec))
    track = FlagTrack(codec, config.nodes)
    run = _Run(scenario, gateway, track, left, progress)
    stop = Stop()
    drives = [name, "--dbc", str(codec.path), *bus_arguments(options)]
    drives += _authentication(config, gateway)
    if left is not None:
        left.begin(gateway)
        (left.folder / TRUTH).unlink(missing_ok=True)
        drives += ["--truth", str(left.folder / TRUTH)]
    child = subprocess.Popen([sys.executable, "-m", "gateway", "sim", "--wait-for-start", *drives])

    def watch(seen: LiveSnapshot) -> None:
        run.observe(seen)
        if child.poll() is not None:
            stop()

    try:
        node = CanopenNode(config.nodes, nmt_master=True)
        seen = run_live(gateway, transport, node, ticker, stop=stop, on_tick=watch)
    finally:
        if child.poll() is None:
            child.terminate()
        child.wait(timeout=10)
    if stop.ended is not None:
        raise stop.ended  # an incomplete run has no verdict
    if child.returncode:
        msg = f"the simulated drives' process ended early, with exit code {child.returncode}"
        raise ChildProcessError(msg)
    if left is not None:
        left.set_timing(seen, ticker.period_ns)
        left.read_truth(left.folder / TRUTH)
    verdicts = judge(scenario.expect, track, touched_drives(scenario), run.start_ns or 0)
    return Outcome(scenario, verdicts, gateway, str(run.overload))
