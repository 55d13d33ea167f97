"""`python -m bench.held_plant`: the gateway on a train whose speed is held whatever it carries.

A second world beside `sim/physics/plant.py`, written apart from it: no mechanics at all. The rotor
turns at a given speed, as behind an ideally stiff control; the motor's torque is at every instant
what the wheel carries; flux, current and voltage follow in closed form:

    i_q = T / (k_p p psi),  i_d = 0;    psi_s = (L i + psi) e^(j theta)
    mean u over a period = R mean i + (psi_s at its end - psi_s at its begin) / dt

Losses have edges of 1 to 8 ms. Sensors, messages and truth are the simulator's. Kinds, by name:
what is lost, of how many drives, with or without `Status` (and so with or without a torque command)
on the bus, and what is healthy before.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.motulator_log import OtherMachine, periods
from dbc.codec import Codec
from dbc.frames import Block, block_of
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
from gateway.study.scenarios_random import PerUnit, between, sign
from sim.drive_spread import Variety
from sim.faults import Schedule
from sim.physics import plant as columns
from sim.physics.plant import DT, MOTORS, OUT
from sim.profile import Profile
from sim.scenario import Scenario, parse
from sim.simulation import ANGLE_STREAM, GRID, GRID_NS, Simulation

Array = NDArray[np.float64]
Rng = np.random.Generator
STREAM: Final = 31
RAMP_S: Final = (0.001, 0.008)
LENGTH_S: Final = (0.2, 2.0)
DEPTH: Final = (0.2, 1.0)
TAIL_S: Final = 0.8
STATUS: Final = range(0x1C1, 0x1D1)
LATE_S: Final = 0.1
"""After so long a loss should not be called `Adhering` any more."""
WORLDS: Final = ("held", "ours", "motulator")


class Kind(NamedTuple):
    """One kind of runs. lost: how many of `drives`, None for all; commands: `Status` is sent."""

    title: str
    drives: int
    lost: int | None
    commands: bool
    onset_s: tuple[float, float] = (0.75, 1.5)
    rough: bool = False
    healthy: bool = False


KINDS: Final = {
    "one": Kind("one of three", 3, 1, commands=True),
    "one_mute": Kind("one of three, no command", 3, 1, commands=False),
    "majority": Kind("two of three, no command", 3, 2, commands=False),
    "majority_late": Kind("the same after 2.5 s", 3, 2, commands=False, onset_s=(2.5, 3.2)),
    "two": Kind("one of two, no command", 2, 1, commands=False),
    "two_commands": Kind("one of two", 2, 1, commands=True),
    "twelve": Kind("four of twelve, no command", 12, 4, commands=False),
    "rough": Kind(
        "one of three, rough", 3, 1, commands=True, onset_s=(2.5, 3.2), rough=True
    ),
    "rough_mute": Kind(
        "one of three, rough, no command", 3, 1, commands=False, onset_s=(2.5, 3.2), rough=True
    ),
    "all": Kind("all of three", 3, None, commands=True),
    "healthy": Kind("nothing lost, load steps", 3, 0, commands=True, healthy=True),
    "healthy_mute": Kind(
        "nothing lost, load steps, no command", 3, 0, commands=False, healthy=True
    ),
}  # fmt: skip


def draw(name: str, seed: int, motor: str = "bench") -> Scenario:
    """The run of this kind and seed. Raises KeyError for an unknown kind."""
    kind = KINDS[name]
    rng = np.random.default_rng([seed, STREAM, list(KINDS).index(name)])
    unit = PerUnit(motor)
    speed, load = between(rng, unit.speed, 3) * sign(rng), between(rng, (8.0, 30.0)) * sign(rng)
    at = between(rng, kind.onset_s)
    drives = kind.drives
    who = range(drives) if kind.lost is None else rng.choice(drives, kind.lost, replace=False)
    length, depth = between(rng, LENGTH_S), between(rng, DEPTH)
    events: list[dict[str, Any]] = [
        {
            "at_s": round(at + (0.0 if kind.lost is None else between(rng, (0.0, 0.03))), 4),
            "for_s": length if kind.lost is None else between(rng, LENGTH_S),
            "drive": int(d) + 1,
            "kind": "adhesion_loss",
            "depth": depth if kind.lost is None else between(rng, DEPTH),
            "ramp_s": between(rng, RAMP_S),
        }
        for d in who
    ]
    ends = [e["at_s"] + e["for_s"] for e in events]
    # The train's demand: it stays, changes slowly, or (healthy) steps now and then.
    end = max(ends, default=6.0) + TAIL_S
    profile = [[0.0, unit.nm(load)]]
    if kind.healthy:
        while profile[-1][0] < end - 1.0:
            step = between(rng, (0.01, 0.5))
            begin = profile[-1][0] + between(rng, (0.3, 1.0))
            level = unit.nm(between(rng, (-28.0, 28.0)))
            profile += [[round(begin, 4), profile[-1][1]], [round(begin + step, 4), level]]
    elif rng.random() < 0.5:
        profile.append([round(end, 4), round(profile[0][1] * between(rng, (0.7, 1.3)), 4)])
    noise = 1e-2 if kind.rough else 2e-4
    table: dict[str, Any] = {
        "title": f"held, {name} {seed}",
        "seed": seed,
        "drives": drives,
        "duration_s": round(end, 4),
        "motor": {"name": motor},
        "motion": {"speed": speed},
        "load": {"kind": "preset", "profile": profile, "transition": "linear"}
        if len(profile) > 1
        else {"kind": "preset", "torque_nm": profile[0][1]},
        "sensors": {"current_noise_var": unit.noise(noise)},
        "event": events,
    }
    if kind.rough:
        table["load"]["share_within"] = 0.1
        table["mismatch"] = {"R_s_within": 0.2, "L_s_within": 0.05, "psi_pm_within": 0.03}
        table["sensors"]["current_offset_within_a"] = unit.amps(0.1)
        events.append({"at_s": 0.0, "kind": "frame_loss", "depth": 0.01})
    if drives > 4 or not kind.commands:
        table["bus"] = {"bitrate": 0}
    return parse(table, table["title"])


def waveforms(scenario: Scenario) -> Array:
    """(n, N, 10) rows of a whole run, columns `sim.physics.plant.OUT`."""
    motor = MOTORS[scenario.motor.name]
    variety = Variety(scenario, motor)
    p = variety.p
    n = periods(scenario)
    t_s: Array = DT * np.arange(n + 1, dtype=np.float64)
    w_ref, _, demand = Profile(scenario, motor.pole_pairs).at(t_s)
    load = demand[:, None] * variety.share(0.0) * Schedule(scenario, motor).carry(t_s, demand)
    turned = DT * np.concatenate([[0.0], np.cumsum(0.5 * (w_ref[1:] + w_ref[:-1]))])
    out = np.empty((n, scenario.drives, OUT))
    for d in range(scenario.drives):
        theta_0 = np.random.default_rng([scenario.seed, ANGLE_STREAM, d]).uniform(0.0, 2.0 * np.pi)
        theta = theta_0 + motor.pole_pairs * turned / p.wheel[d]
        along = np.exp(1j * theta)
        i_q = load[:, d] / (motor.k_p * motor.pole_pairs * p.psi_pm[d])
        current = 1j * i_q * along
        flux = p.L_s[d] * current + p.psi_pm[d] * along
        voltage = p.R_s[d] * 0.5 * (current[1:] + current[:-1]) + np.diff(flux) / DT
        row = out[:, d]
        row[:, columns.I_ALPHA], row[:, columns.I_BETA] = current[1:].real, current[1:].imag
        row[:, columns.U_ALPHA], row[:, columns.U_BETA] = voltage.real, voltage.imag
        row[:, columns.U_DC] = motor.U_dc
        row[:, columns.TORQUE] = row[:, columns.LOAD] = load[1:, d]
        row[:, columns.SPEED] = w_ref[1:] / p.wheel[d]
        row[:, columns.ANGLE] = theta[1:] % (2.0 * np.pi)
        row[:, columns.COMMAND] = demand[1:]
    return out


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
        blocks = [_without_status(block) for block in blocks]
    return Recording(scenario, blocks, simulation.truth_rows())


def _without_status(block: Block) -> Block:
    return block.pick(~np.isin(block.can_id, list(STATUS)))


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
