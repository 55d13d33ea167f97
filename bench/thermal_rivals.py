"""Tuning of the thermal rivals, as hard as ours: `python -m bench.thermal_rivals BASE [NAME ...]`.

One parameter after the other takes the value with the least sum of graced false positives and
misses, over all kinds of faults and fault-free runs of development trains, by the one limit rule;
what is best goes on. Two rounds. Never on reporting seeds. (By accuracy silence would win: three
quarters of the samples are healthy.)
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gateway.io.workers import workers
from gateway.study import thermal_trials as trials
from gateway.study.thermal_dataset import BASES, KINDS
from gateway.study.thermal_scores import score_alarms

GRID: dict[str, dict[str, Sequence[object]]] = {
    "dpca": {
        "view": ("others", "between"), "window": (0.0, 0.002, 0.005, 0.01, 0.02, 0.04),
        "kept": (0.7, 0.8, 0.9, 0.97), "lags": (0, 1, 2),
    },
    "dsfa": {
        "window": (0.0, 0.002, 0.005, 0.01, 0.02, 0.04), "slow": (0.25, 0.5, 0.75),
        "width": (7, 14, 24), "lags": (0, 1, 2),
    },
    "jitl": {
        "window": (0.0, 0.002, 0.005, 0.01, 0.02, 0.04), "ridge": (1.0, 10.0, 100.0),
        "neighbours": (30, 60, 150),
    },
    "ekf": {
        "window": (0.0, 0.002, 0.005, 0.01, 0.03), "walk": (0.001, 0.01, 0.1),
        "joint": (True, False), "prior_sigma": (0.001, 0.05),
    },
    "paper_causal": {"window": (1, 3, 5, 9, 15, 30, 60, 120)},
    "lstm": {"window": (0.0, 0.005, 0.02), "hidden": (16, 32)},
}  # fmt: skip


@functools.cache
def _runs(seed: int, base: str) -> trials.Runs:
    return trials.runs_of(seed, BASES[base], (*KINDS, trials.HEALTHY))


def accuracies(task: tuple[int, str, Any]) -> list[tuple[float, float, float]]:
    """(seed, base, method) -> accuracy, FPR, FNR of every run of that train."""
    seed, base, method = task
    healthy, limiting, runs = _runs(seed, base)
    fitted = trials.fit(method, healthy)
    limit = float(np.nanquantile(fitted(limiting), trials.LIMIT))
    scores = [
        score_alarms(fitted(trials.record_of(run)), limit, trials.truth_of(run, BASES[base]))
        for run in runs.values()
    ]
    return [(one.accuracy, one.graced_fpr, one.graced_fnr) for one in scores]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("base", choices=BASES)
    parser.add_argument("name", nargs="*", help=f"default: all of {', '.join(GRID)}")
    parser.add_argument("--trains", type=int, default=10, help="development trains")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    options = parser.parse_args()
    seeds = trials.DEVELOPMENT[: options.trains]
    with workers(options.jobs) as pool:
        for name in options.name or GRID:
            best, least = trials.METHODS[options.base][name], np.inf
            for _ in range(2):
                before = best
                for parameter, values in GRID[name].items():
                    for value in values:
                        method = replace(best, **{parameter: value})
                        if least < np.inf and method == best:
                            continue
                        tasks = [(seed, options.base, method) for seed in seeds]
                        rows = [row for part in pool.map(accuracies, tasks) for row in part]
                        right, false, missed = np.nanmean(np.array(rows), axis=0)
                        print(f"{name} {parameter} {value}: {right:.2%} graced {false:.1%} "
                              f"{missed:.1%}", flush=True)  # fmt: skip
                        if false + missed < least:
                            best, least = method, false + missed
                if best == before:
                    break
            print(f"{options.base}: {best} {least:.1%}", flush=True)


if __name__ == "__main__":
    main()
