"""Evaluation of detectors: random runs by seed through the simulator and the core, open loop.

The drives do not receive the gateway's frames, as in a recorded log: every detector gets the same
frames, and a run is simulated once for all. The clock is virtual, so results are reproducible.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

from dbc.codec import Codec, bind
from dbc.frame import Frame
from dbc.frames import Block, block_of
from estimators.detect import DETECTORS, WITH_MEMORY
from gateway.core.gateway import Gateway
from gateway.io.workers import mapped
from gateway.settings.config import Config, ConfigError, load
from gateway.settings.motors import Motor
from gateway.settings.sections import Drive
from gateway.study.evaluation import Line, Measured, listen, measure
from gateway.study.scenarios_family import DEVELOPMENT, REPORTING
from gateway.study.varied_trains import Variation, variation
from gateway.study.worlds import WORLDS, Family
from sim.ground_truth import Truth
from sim.scenario import Scenario
from sim.simulation import Simulation


class Plan(NamedTuple):
    """Scope of an evaluation. config: basic configuration; the scenario replaces its drives."""

    families: tuple[str, ...]
    detectors: tuple[str, ...]
    seeds: tuple[int, ...]
    dbc: str | None = None
    motor: str = "bench"
    config: Path | None = None
    world: str = "ours"


OWN = "varied"
"""Name of a motor that belongs to the run."""
TICKS_PER_S = 100
"""Runs take whole steps of 10 ms."""


class Recording(NamedTuple):
    """A simulated run: the drives' frames, a block per tick, and the truth.

    variation: motor and bus of the run, where they are not those of the plan.
    """

    scenario: Scenario
    blocks: list[Block]
    truth: list[Truth]
    variation: Variation | None = None


def seeds_of(
    text: str, development: range = DEVELOPMENT, reporting: range = REPORTING
) -> tuple[int, ...]:
    """Seeds by name (`development`, `reporting`) or as `A-B` or `A`.

    Raises ConfigError for anything else, and for numbers that are kept for reporting, which
    must be asked for by name.
    """
    if text in ("development", "reporting"):
        return tuple(development if text == "development" else reporting)
    first, dash, last = text.partition("-")
    digits = first.isdecimal() and (last.isdecimal() or not dash)
    seeds = range(int(first), int(last if dash else first) + 1) if digits else range(0)
    if not seeds:
        raise ConfigError("--seeds", [f"{text!r} is none of development, reporting, A-B"])
    if set(seeds) & set(reporting):
        kept = f"{reporting.start}-{reporting.stop - 1}"
        raise ConfigError("--seeds", [f"{kept} are kept for reporting; say --seeds reporting"])
    return tuple(seeds)


def known_detectors(names: Iterable[str], plan: Plan) -> tuple[list[str], list[str]]:
    """Detectors that can be configured, and a line for each of the others."""
    good, bad = [], []
    for name in names:
        if name not in DETECTORS | WITH_MEMORY:
            there_are = ", ".join(DETECTORS | WITH_MEMORY)
            bad.append(f"{name}: no such detector; there are {there_are}")
            continue
        try:
            _base(plan.config, plan.dbc, name)
        except ConfigError as error:
            bad.append(f"{name}: {'; '.join(error.problems)}")
        else:
            good.append(name)
    return good, bad


@cache
def _base(path: Path | None, dbc: str | None, detector: str) -> Config:
    sections = {"adhesion": {"detector": detector}, "dbc": {"file": dbc} if dbc else {}}
    return load(path, **sections)


@cache
def _codec(path: Path, nodes: tuple[int, ...]) -> Codec:
    return bind(path, nodes)


def fitted(
    plan: Plan, detector: str, scenario: Scenario, varied: Variation | None = None
) -> tuple[Config, Codec]:
    """Configuration and codec for the scenario's drives, with the motors of the data sheet."""
    motor = OWN if varied else scenario.motor.name
    drives = tuple(Drive(node=n, motor=motor) for n in range(1, scenario.drives + 1))
    config = _base(plan.config, plan.dbc, detector).model_copy(update={"drive": drives})
    if varied:
        sheet = varied.sheet()
        del sheet["U_dc"]
        config = config.model_copy(update={"motor": {OWN: Motor(**sheet)}})
        return config, varied.codec(_codec(config.dbc_path, config.nodes))
    if motor not in config.motors:
        raise ConfigError("motor", [f"no [motor.{motor}]; known: {', '.join(config.motors)}"])
    return config, _codec(config.dbc_path, config.nodes)


def _drawn(plan: Plan, family: str, seed: int) -> Scenario:
    return WORLDS[plan.world].draw(family, seed, plan.motor)


def record(scenario: Scenario, config: Config, codec: Codec) -> Recording:
    """Simulate a whole run of our own world."""
    return _recording(WORLDS["ours"].simulate("", scenario, codec), Family(), config)


def recorded(plan: Plan, family: str, seed: int) -> Recording:
    """Simulate one of the plan's runs: the frames that its drives send, and the truth."""
    scenario = _drawn(plan, family, seed)
    about = WORLDS[plan.world].families[family]
    varied = variation(seed) if about.varied else None
    config, codec = fitted(plan, plan.detectors[0], scenario, varied)
    machines = WORLDS[plan.world].simulate(family, scenario, codec)
    recording = _recording(machines, about, config)
    if varied is None:
        return recording
    blocks = [varied.received(block, codec) for block in recording.blocks]
    return recording._replace(blocks=blocks, variation=varied)


def _recording(simulation: Simulation, family: Family, config: Config) -> Recording:
    scenario = simulation.scenario
    ticks = round(scenario.duration_s * TICKS_PER_S) * config.loop.rate_hz // TICKS_PER_S
    blocks = [
        family.received(block_of(simulation.step((), tick * config.loop.period_ns)))
        for tick in range(ticks + 1)
    ]
    return Recording(scenario, blocks, simulation.truth_rows())


def judge(recording: Recording, config: Config, codec: Codec) -> Measured:
    """Run the configured detector over a recording and measure it."""
    gateway = Gateway(config, codec, 0)
    sent: list[Frame] = []
    for tick, block in enumerate(recording.blocks):
        sent += gateway.step(block, tick * config.loop.period_ns)
    return measure(recording.truth, listen(sent, codec, config.nodes), config.nodes)


def one_run(plan: Plan, family: str, seed: int) -> tuple[Measured, ...]:
    """Simulate one scenario once, and judge every detector of the plan on it."""
    recording = recorded(plan, family, seed)
    about = recording.scenario, recording.variation
    fits = [fitted(plan, name, *about) for name in plan.detectors]
    return tuple(judge(recording, *fit) for fit in fits)


def evaluate(
    plan: Plan,
    jobs: int = 1,
    after_run: Callable[[], None] = lambda: None,
    after_family: Callable[[str, float], None] = lambda _family, _seconds: None,
) -> list[Line]:
    """Evaluate a whole plan; lines are in its order, whatever the number of processes.

    `after_run` is called after every scenario, `after_family` with its name and the time taken.
    Raises ConfigError or DbcMismatch before anything is simulated.
    """
    for family in plan.families:
        if not WORLDS[plan.world].families[family].varied:
            fitted(plan, plan.detectors[0], _drawn(plan, family, plan.seeds[0]))
    runs = list(product(plan.families, plan.seeds))
    found: dict[str, list[tuple[Measured, ...]]] = {family: [] for family in plan.families}
    began = time.monotonic()
    results = mapped(partial(_run_of, plan), runs, jobs)
    for (family, _), result in zip(runs, results, strict=True):
        found[family].append(result)
        after_run()
        if len(found[family]) == len(plan.seeds):
            after_family(family, time.monotonic() - began)
            began = time.monotonic()
    return [line for family in plan.families for line in _lines(plan, family, found[family])]


def _run_of(plan: Plan, which: tuple[str, int]) -> tuple[Measured, ...]:
    return one_run(plan, *which)


def _lines(plan: Plan, family: str, results: Sequence[tuple[Measured, ...]]) -> list[Line]:
    from sim.physics.plant import MOTORS

    about = WORLDS[plan.world].families[family]
    rated = math.nan if about.varied else MOTORS[about.motor or plan.motor].T_rated
    return [
        Line(family, detector, plan.seeds, runs, about.common, rated)
        for detector, runs in zip(plan.detectors, zip(*results, strict=True), strict=True)
    ]
