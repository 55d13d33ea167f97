"""`python -m bench.load_band`: how often the true load lies within 2 sigma of its estimate.

Of drives that track; edges and the first half second left out, as in `docs/detection.md`. Where
currents are fast enough the load is that of the filters, else of the observer of speed and torque:
a row for each. Normal errors with a right sigma would be inside for 95.4 % of the time.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags
from gateway.core.codes import Health
from gateway.core.gateway import Gateway
from gateway.io.workers import workers
from gateway.reports.scoring import truth_of
from gateway.study.evaluation import load_error
from gateway.study.evaluation_runs import Plan, Recording, fitted, recorded, seeds_of
from gateway.study.scenarios_family import FAMILIES, GROUPS
from gateway.study.worlds import WORLDS

MOTORS: Final = ("bench", "traction_350kw")
SOURCES: Final = ("filters", "observer")
FEWEST: Final = 200
"""Ticks that a row needs."""
FIELDS: Final = ("load_nm", "load_sigma_nm", "health")


class Loads(NamedTuple):
    """Of all drives and ticks that count, (K,): error and sigma, Nm; whether the observer's."""

    error: Array
    sigma: Array
    observed: Flags


def loads(recording: Recording, plan: Plan) -> Loads:
    """What a gateway makes of one recording, against its truth."""
    config, codec = fitted(plan, "switching", recording.scenario)
    gateway, rows, times = Gateway(config, codec, 0), [], []
    for tick, block in enumerate(recording.blocks):
        gateway.step(block, tick * config.loop.period_ns)
        drives = gateway.status.drives
        observed = gateway.bank.estimates["by_observer"]
        rows.append(np.stack([*(drives[name] for name in FIELDS), observed], axis=1))
        times.append(gateway.now_ns / 1e9)
    t_s, known = np.array(times), np.array(rows)
    found = []
    for k, node in enumerate(config.nodes):
        truth = truth_of(recording.truth, node)
        load, sigma, health, observed = known[:, k].T
        error = load_error(recording.truth, node, truth, t_s, load)
        good = (health == Health.TRACKING) & np.isfinite(error)
        found.append(Loads(error[good], sigma[good], observed[good] > 0.0))
    return together(found)


def together(parts: Iterable[Loads]) -> Loads:
    return Loads(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def one(task: tuple[str, str, str, int]) -> Loads:
    """One run: (world, kind or family, motor, seed)."""
    world, name, motor, seed = task
    plan = Plan((), ("switching",), (seed,), None, motor, None, world)
    return loads(recorded(plan, name, seed), plan)


def row(found: Loads) -> str:
    """Ticks, share inside, root mean square of the error, median sigma."""
    inside = 100.0 * float(np.mean(np.abs(found.error) <= 2.0 * found.sigma))
    rms = float(np.sqrt(np.mean(found.error**2)))
    return f"{len(found.error)} | {inside:.1f} | {rms:.3g} | {np.median(found.sigma):.3g}"


def kinds_of(world: str) -> tuple[str, ...]:
    """What there is to be drawn in a world."""
    if world == "ours":
        return (*FAMILIES, *GROUPS["mismatch"])
    return WORLDS[world].usual if world == "roller" else ("one", "rough", "healthy")


def table(worlds: Iterable[str], seeds: tuple[int, ...], jobs: int) -> Iterator[str]:
    kinds = [(world, name) for world in worlds for name in kinds_of(world)]
    yield "| world | kind | motor | load by | ticks | inside % | rms error Nm | sigma Nm |"
    yield "|---|---|---|---|---|---|---|---|"
    with workers(jobs) as pool:
        for world, name in kinds:
            for motor in MOTORS:
                found = together(pool.map(one, [(world, name, motor, seed) for seed in seeds]))
                for source, observed in zip(SOURCES, (False, True), strict=True):
                    part = Loads(*(column[found.observed == observed] for column in found))
                    if len(part.error) >= FEWEST:
                        yield f"| {world} | {name} | {motor} | {source} | {row(part)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("2100-2104"))
    parser.add_argument("--world", nargs="*", choices=WORLDS, default=("held", "ours"))
    parser.add_argument("-j", "--jobs", type=int, default=2)
    options = parser.parse_args()
    for line in table(options.world, options.seeds, options.jobs):
        print(line, flush=True)


if __name__ == "__main__":
    main()
