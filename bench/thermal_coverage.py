"""`python -m bench.thermal_coverage [--world other] [A-B]`: may a coverage decide who is judged?

For each train: what `calibrate` prints of the model alone (share of the second half of the
held-back run within two sigma of the first), and the same beside the other motors on one more
fault-free run, with its autocorrelation from minute to minute. Then the filters' own prediction on
the held-back run: largest inflation, smallest coverage, motors that are not explained. Development
seeds.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.model import inputs_of, predict
from estimators.thermal.model_method import learn
from estimators.thermal.record import Record, of_driven_motors
from estimators.thermal.system_identification import first_readings, identify
from gateway.study.calibration_fit import LEAST_INSIDE, fits
from gateway.study.evaluation_runs import seeds_of
from gateway.study.thermal_dataset import BENCH
from gateway.study.thermal_trials import DEVELOPMENT, REPORTING, WORLDS, runs_of

MINUTE = 60


def beside(parameters: Array, run: Record) -> Array:
    """(K, M, 3) K: residual of the model less the median of the other motors'; M of at least 2."""
    off = run.temperature - predict(parameters, inputs_of(run), first_readings(run))
    others = [np.nanmedian(np.delete(off, j, axis=1), axis=1) for j in range(run.motors)]
    return off - np.stack(others, axis=1)


def lag_one(minutes: Array) -> Array:
    """Autocorrelation along the first axis at one step."""
    off = minutes - minutes.mean(axis=0)
    return np.asarray((off[1:] * off[:-1]).sum(axis=0) / (off**2).sum(axis=0))


class Row(NamedTuple):
    """Of one train: motors, and how many of them are covered; see above."""

    motors: int
    printed: int
    beside: int
    lag_one: float
    inflation: float
    covered: float
    unexplained: int


def measured(seed: int, world: str) -> Row | None:
    """None of a train with a single motor, which has no others."""
    runs = runs_of(seed, BENCH, (), world)
    motors = runs.limiting.motors
    if motors < 2:
        return None
    healthy = [of_driven_motors(run) for run in runs.healthy]
    known = learn(identify(healthy[:-1]), healthy)
    printed = sum(fit.explained for fit in fits(known, healthy[-1], range(motors)))
    first, then = (beside(known.parameters, run) for run in (healthy[-1], runs.limiting))
    centre, sigma = np.nanmedian(first, axis=0), np.nanstd(first, axis=0)
    inside = (np.abs(then - centre) <= 2.0 * sigma).mean(axis=0).min(axis=1)
    whole = then[: len(then) // MINUTE * MINUTE].reshape(-1, MINUTE, motors, 3).mean(axis=1)
    own = known.coverage
    assert own is not None
    return Row(
        motors, printed, int((inside >= LEAST_INSIDE).sum()), float(lag_one(whole).mean()),
        float(own.inflation.max()), float(np.nanmin(own.covered)), int(own.unexplained.sum()),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="0-11", help="A-B")
    parser.add_argument("--world", choices=list(WORLDS), default="ours")
    options = parser.parse_args()
    rows = []
    for seed in seeds_of(options.seeds, DEVELOPMENT, REPORTING):
        row = measured(seed, options.world)
        if row is not None:
            rows.append(row)
            print(
                f"train {seed}: {row.motors} motors, covered {row.printed}, beside the others "
                f"{row.beside}; lag one {row.lag_one:.2f}; filters: inflation {row.inflation:.2f}, "
                f"covered {row.covered:.2f}, unexplained {row.unexplained}"
            )
    every = [np.array(part) for part in zip(*rows, strict=True)]
    motors, printed, covered, lag, inflation, _, unexplained = every
    print(
        f"{motors.sum()} motors: covered {printed.sum()}, beside the others {covered.sum()}; "
        f"lag one {lag.mean():.2f}; filters: {(inflation > 1.1).sum()} of {len(rows)} trains "
        f"inflated by more than 1.1, {unexplained.sum()} motors unexplained"
    )


if __name__ == "__main__":
    main()
