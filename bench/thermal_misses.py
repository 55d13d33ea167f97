"""`python -m bench.thermal_misses [A-B] [-j N] [--world W]`: why samples with a fault are missed.

Points of the graced FNR by cause, kind of fault and number of motors, at one sample a second.
"""

from __future__ import annotations

import argparse
import functools
from collections import defaultdict

import numpy as np

from dbc.arrays import Array, Flags
from estimators.thermal.model_method import Watching
from gateway.io.workers import mapped
from gateway.study import thermal_trials as trials
from gateway.study.evaluation_runs import seeds_of
from gateway.study.thermal_dataset import BENCH, KINDS
from gateway.study.thermal_scores import SHOWN_K, Truth

CAUSES = ("Unknown (Config)", "below the limit", "not yet", "lost again", "never")


def cause_of(statistic: Array, limit: float, truth: Truth, unknown: bool) -> Array:
    """(5,) points of the graced FNR of one run, %, by `CAUSES`; statistic (K, M)."""
    judged: Flags = truth.faulty & ((truth.effect >= SHOWN_K) | truth.loose)
    found = statistic.max(axis=1) > limit
    missed = judged & ~found
    if unknown:
        parts = [missed]
    else:
        likely = missed & (statistic[:, truth.motor] > 0.0)
        rest = missed & ~likely
        hits = np.flatnonzero(found & truth.faulty)
        late = np.arange(len(found)) < hits[0] if len(hits) else np.zeros_like(found)
        lost = ~late & (len(hits) > 0)
        parts = [np.zeros_like(found), likely, rest & late, rest & lost, rest & ~late & ~lost]
    parts += [np.zeros_like(found)] * (len(CAUSES) - len(parts))
    return np.array([100.0 * part.sum() / max(judged.sum(), 1) for part in parts])


def misses(seed: int, world: str) -> list[tuple[int, str, Array]]:
    """(motors, kind, points by cause) of each run of a train."""
    runs = trials.runs_of(seed, BENCH, KINDS, world)
    fitted = trials.fit(trials.METHODS[BENCH.name]["model"], runs.healthy)
    assert isinstance(fitted, Watching)
    coverage = fitted.known.coverage
    assert coverage is not None
    limit = float(np.nanquantile(fitted(runs.limiting), trials.LIMIT))
    out = []
    for kind, run in runs.judged.items():
        truth = trials.truth_of(run, BENCH)
        statistic = fitted.believe(trials.record_of(run)).statistic
        unknown = bool(coverage.unexplained[truth.motor])
        out.append((run.temperature.shape[1], kind, cause_of(statistic, limit, truth, unknown)))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="development", help="or A-B")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument("--world", default="other", choices=trials.WORLDS)
    options = parser.parse_args()
    seeds = seeds_of(options.seeds, trials.DEVELOPMENT, trials.REPORTING)
    rows: dict[str, list[Array]] = defaultdict(list)
    for each in mapped(functools.partial(misses, world=options.world), seeds, options.jobs):
        for motors, kind, points in each:
            for row in ("all", kind, f"motors: {motors:2d}"):
                rows[row].append(points)
    print(f"{'graced FNR, points':24}", *(f"{cause:>17}" for cause in CAUSES), "  runs")
    for row in ("all", *KINDS, *sorted(set(rows) - {"all", *KINDS})):
        points = np.mean(rows[row], axis=0)
        print(f"{row:24}", *(f"{value:17.1f}" for value in points), f"{len(rows[row]):6d}")


if __name__ == "__main__":
    main()
