"""Mutation test: whether scenarios detect a gateway with a fault (`hil --mutate`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from gateway.core.gateway import Gateway
from gateway.hil.bench import run_virtual, touched_drives
from gateway.hil.mutants import Mutant, Sent, decoded, encoded
from gateway.reports.expectations import FlagTrack, judge
from gateway.settings.config import Config
from sim.scenario import Scenario


class Recorded(NamedTuple):
    """A scenario with the flag frames of a gateway without fault; passed: all expectations held."""

    name: str
    scenario: Scenario
    codec: Codec
    nodes: tuple[int, ...]
    sent: list[Sent]
    passed: bool


class Result(NamedTuple):
    """Result for a mutant.

    noticed_by: scenario with a failed expectation, or None; alters: whether it changed any frame.
    """

    mutant: Mutant
    noticed_by: str | None
    alters: bool


def record(name: str, scenario: Scenario, config: Config, codec: Codec) -> Recorded:
    """Run a scenario on the virtual clock. Raises ConfigError as `Gateway` does."""
    sent: list[Sent] = []

    def keep(_now: Nanos, _received: list[Frame], frames: list[Frame], _gateway: Gateway) -> None:
        sent.extend(decoded(codec, frames))

    outcome = run_virtual(scenario, config, codec, [keep])
    return Recorded(name, scenario, codec, tuple(config.nodes), sent, outcome.passed)


def judged(mutant: Mutant, suite: Sequence[Recorded]) -> Result:
    """Whether an expectation of any scenario fails with the mutant. Short runs are tried first."""
    alters = False
    for run in sorted(suite, key=lambda run: len(run.sent)):
        altered = mutant.alter(run.sent, run.nodes)
        if altered == run.sent:
            continue
        alters = True
        track = FlagTrack(run.codec, run.nodes)
        track.add(encoded(run.codec, altered))
        verdicts = judge(run.scenario.expect, track, touched_drives(run.scenario), 0)
        if not all(verdict.passed for verdict in verdicts):
            return Result(mutant, run.name, True)
    return Result(mutant, None, alters)
