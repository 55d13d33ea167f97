"""`python -m bench.thermal_healthy [A-B] [-j N]`: false episodes in many fault-free hours.

`evaluate thermal` judges one fault-free run of two hours a train; rates of less than one a day
need more. Runs of their own: none of them is in the benchmark.
"""

from __future__ import annotations

import argparse

import numpy as np

from gateway.io.workers import mapped
from gateway.reports.scoring import stretches
from gateway.study import thermal_trials as trials
from gateway.study.evaluation_runs import seeds_of
from gateway.study.thermal_dataset import BENCH, train

RUNS = range(20, 25)
"""Numbers of the runs of a train."""
DAYS_A_TRAIN = len(RUNS) * BENCH.samples * BENCH.sample_s / 86_400.0


def episodes(seed: int) -> list[tuple[int, int, int, int]]:
    """(train, run, begin s, length s) of every one."""
    fits = trials.FIT_RUNS[BENCH.name]
    new = [trials.record_of(train(seed, BENCH, None, n, new=True)) for n in range(fits + 1)]
    fitted = trials.fit(trials.METHODS[BENCH.name]["model"], new[:fits])
    limit = float(np.nanquantile(fitted(new[fits]), trials.LIMIT))
    out = []
    for run in RUNS:
        above = fitted(trials.record_of(train(seed, BENCH, None, run))) > limit
        out += [(seed, run, a, b - a) for a, b in stretches(above)]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="development", help="or reporting, or A-B")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    options = parser.parse_args()
    seeds = seeds_of(options.seeds, trials.DEVELOPMENT, trials.REPORTING)
    found = [each for some in mapped(episodes, seeds, options.jobs) for each in some]
    for each in found:
        print("train {}, run {}: from {} s for {} s".format(*each))
    days = DAYS_A_TRAIN * len(seeds)
    print(f"{len(found)} in {days:.1f} fault-free days: {len(found) / days:.2f} a day")


if __name__ == "__main__":
    main()
