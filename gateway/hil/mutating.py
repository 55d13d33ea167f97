"""Mutation test: whether scenarios or tests detect a gateway with a fault (`hil --mutate`)."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.etree import ElementTree as ET

from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from gateway.core.gateway import Gateway
from gateway.hil.bench import run_virtual, touched_drives
from gateway.hil.mutants import Mutant, Sent, altered, decoded, encoded
from gateway.reports.expectations import FlagTrack, judge
from gateway.settings.config import Config, ConfigError
from sim.scenario import Scenario


class Recorded(NamedTuple):
    """A scenario with the flag frames of a gateway without fault; passed: all expectations held."""

    name: str
    scenario: Scenario
    config: Config
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
    return Recorded(name, scenario, config, codec, tuple(config.nodes), sent, outcome.passed)


def judged(mutant: Mutant, suite: Sequence[Recorded]) -> Result:
    """Whether an expectation of any scenario fails with the mutant. Short runs are tried first.

    Frames are altered after the run, in which the drives received those without a fault.
    """
    alters = False
    for run in sorted(suite, key=lambda run: len(run.sent)):
        sent = altered(mutant, _sent(mutant, run), run.nodes)
        if sent == run.sent:
            continue
        alters = True
        track = FlagTrack(run.codec, run.nodes)
        track.store(encoded(run.codec, sent))
        verdicts = judge(run.scenario.expect, track, touched_drives(run.scenario), 0)
        if not all(verdict.passed for verdict in verdicts):
            return Result(mutant, run.name, True)
    return Result(mutant, None, alters)


def _sent(mutant: Mutant, run: Recorded) -> list[Sent]:
    """The frames to alter: those of the run, or of another run with the mutant's settings."""
    if mutant.settings is None:
        return run.sent
    return record(run.name, run.scenario, mutant.settings(run.config), run.codec).sent


def judged_by_tests(paths: Sequence[str], mutant: str | None = None) -> str | None:
    """Run pytest until a test fails; return the name of that test, or None if all pass.

    mutant: "NUMBER:SEED" of the gateway's fault; None: none. Raises ConfigError with pytest's
    output if it runs no test or ends in another way.
    """
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    words += [] if mutant is None else [f"--hil-mutant={mutant}"]
    with TemporaryDirectory(prefix="hil-") as folder:
        verdicts = Path(folder) / "junit.xml"
        words += [f"--junitxml={verdicts}", *paths]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return None
        if done.returncode != 1:
            raise ConfigError("pytest", [(done.stdout + done.stderr).strip()])
        for case in ET.parse(verdicts).iter("testcase"):  # noqa: S314 written by pytest just now
            if case.find("failure") is not None or case.find("error") is not None:
                return str(case.get("name"))
    return "pytest"
