"""`python -m bench.held_plant`: the gateway on a train whose speed is held whatever it carries.

The world is `gateway.study.held_world`; the same kinds in ours and in motulator's beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frames import block_of
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.io.workers import workers
from gateway.reports.scoring import quantile, truth_of
from gateway.study.evaluation import (
    GatewayOutput,
    Measured,
    listen,
    measure,
    pooled,
    reliability,
)
from gateway.study.evaluation_runs import Plan, Recording, fitted, seeds_of
from gateway.study.held_world import KINDS, OtherMachine, draw, periods, waveforms, without_status
from sim.scenario import Scenario
from sim.simulation import GRID, GRID_NS, Simulation

Array = NDArray[np.float64]
Rng = np.random.Generator
LATE_S: Final = 0.1
"""After so long a loss should not be called `Adhering` any more."""
WORLDS: Final = ("held", "ours", "motulator")


def _simulation(scenario: Scenario, codec: Codec, world: str) -> Simulation:
    if world == "ours":
        return Simulation(scenario, codec)
    if world == "held":
        return OtherMachine(scenario, codec, waveforms(scenario))
    from bench import motulator_plant

    setup = motulator_plant.Setup(60.0, False, "rk4")
    return OtherMachine(scenario, codec, motulator_plant.waveforms(scenario, setup))


def record(plan: Plan, name: str, seed: int, world: str = "held") -> Recording:
    """One run in one of `WORLDS`, as `gateway.study.evaluation_runs.record` gives it."""
    scenario = draw(name, seed, plan.motor)
    _, codec = fitted(plan, "vb", scenario)
    simulation = _simulation(scenario, codec, world)
    ticks = periods(scenario) // GRID
    blocks = [block_of(simulation.step((), tick * GRID_NS)) for tick in range(ticks + 1)]
    if not KINDS[name].commands:
        blocks = [without_status(block) for block in blocks]
    return Recording(scenario, blocks, simulation.truth_rows())


class Danger(NamedTuple):
    """Frames of losses: `Adhering` said after LATE_S, of all; falsely raised, of healthy ones."""

    said: int = 0
    late: int = 0
    false: int = 0
    healthy: int = 0

    def plus(self, other: Danger) -> Danger:
        """Both."""
        return Danger(*(a + b for a, b in zip(self, other, strict=True)))


def danger(recording: Recording, said: GatewayOutput, nodes: Sequence[int]) -> Danger:
    """Of one run; edges and the first `SKIP_S` left out."""
    total = Danger()
    for k, node in enumerate(nodes):
        truth = truth_of(recording.truth, node)
        row = truth.at(said.t_s)
        lost = truth.lost[row] & (row >= 0)
        counted = truth.counted(said.t_s)
        onsets = np.concatenate([[-np.inf], truth.t_s[[first for first, _ in truth.losses()]]])
        since = said.t_s - onsets[np.searchsorted(onsets, said.t_s, side="right") - 1]
        late, flag = lost & counted & (since > LATE_S), said.flags[:, k]
        total = total.plus(
            Danger(
                int((late & (flag == Flag.GOOD)).sum()), int((lost & counted).sum()),
                int((counted & ~lost & (flag == Flag.BAD)).sum()), int((counted & ~lost).sum()),
            )
        )  # fmt: skip
    return total


class Found(NamedTuple):
    """Pooled over runs."""

    measured: Measured
    danger: Danger


def run(plan: Plan, name: str, seed: int, world: str) -> dict[str, Found]:
    """One run of the world, with every detector of the plan."""
    recording = record(plan, name, seed, world)
    found = {}
    for one in plan.detectors:
        config, codec = fitted(plan, one, recording.scenario)
        gateway, sent = Gateway(config, codec, 0), []
        for tick, block in enumerate(recording.blocks):
            sent += gateway.step(block, tick * config.loop.period_ns)
        said = listen(sent, codec, config.nodes)
        measured = measure(recording.truth, said, config.nodes)
        found[one] = Found(measured, danger(recording, said, config.nodes))
    return found


def _run(task: tuple[Plan, str, int, str]) -> dict[str, Found]:
    return run(*task)


HEADER: Final = (
    "kind", "world", "detector", "runs", "F1", "dangerous %", "false %", "adhering %", "missed",
    "delay ms", "delay abrupt ms", "ECE",
)  # fmt: skip


def line(name: str, world: str, detector: str, runs: Sequence[Found]) -> list[str]:
    """One line of the table."""
    measured, harm = pooled(one.measured for one in runs), Danger()
    for one in runs:
        harm = harm.plus(one.danger)
    flags = measured.flags
    lossy = flags.losses > 0
    delays = [
        f"{quantile(each, 0.5):.0f}" if each else "-" for each in (flags.delays_ms, flags.abrupt_ms)
    ]
    return [
        name, world, detector, str(len(runs)), f"{flags.f1:.4f}" if lossy else "-",
        f"{100.0 * harm.said / harm.late:.2f}" if harm.late else "-",
        f"{100.0 * harm.false / max(harm.healthy, 1):.3f}", f"{100.0 * flags.good_share:.2f}",
        f"{flags.missed} of {flags.losses}", *delays,
        f"{reliability(measured.levels).error:.4f}",
    ]  # fmt: skip


def _measure(options: argparse.Namespace) -> list[list[str]]:
    plan = Plan(
        (), tuple(options.detector), options.seeds, options.dbc, options.motor, options.config
    )
    lines = []
    with workers(options.jobs) as pool:
        for name in options.kind:
            for world in options.world:
                tasks = [(plan, name, seed, world) for seed in plan.seeds]
                runs = list(pool.map(_run, tasks))
                lines += [
                    line(name, world, one, [each[one] for each in runs]) for one in plan.detectors
                ]
                print(f"{name} in {world}", file=sys.stderr, flush=True)
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--seeds", type=seeds_of, default="development", metavar="A-B",
                        help="or reporting")  # fmt: skip
    parser.add_argument("--kind", nargs="+", choices=tuple(KINDS), default=list(KINDS))
    parser.add_argument("--world", nargs="+", choices=WORLDS, default=["held"],
                        help="whose machines (default: held)")  # fmt: skip
    parser.add_argument("--detector", nargs="+", default=["vb", "switching"])
    parser.add_argument("--motor", default="bench")
    parser.add_argument("--dbc", help="message set (default: traction.dbc)")
    parser.add_argument("--config", type=Path, help="times and thresholds")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    print("| " + " | ".join(HEADER) + " |\n|" + " --- |" * len(HEADER))
    for each in _measure(options):
        print("| " + " | ".join(each) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
