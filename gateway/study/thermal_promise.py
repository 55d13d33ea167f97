"""Check whether a stated rate of false alarms is kept, in other hours than those of its limit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from estimators.thermal.model_method import ModelMethod, Watching
from estimators.thermal.monitor import ThermalMonitor, followed
from estimators.thermal.promise import hourly, hours_of, promise_of
from estimators.thermal.record import Record, spacing
from estimators.tolerance import Promise
from gateway.io.workers import mapped
from gateway.reports.scoring import stretches
from gateway.study.thermal_dataset import BENCH, KINDS
from gateway.study.thermal_scores import Score, mean, table_of
from gateway.study.thermal_trials import FIT_RUNS, WORLDS, Shared, judge, record_of

RUN_H = BENCH.samples * BENCH.sample_s / 3600.0
FIRST = 100
"""Number of the first fault-free run from which nothing is learnt."""


class Split(NamedTuple):
    """Stated rate in 1000 h; calibration_h: hours for the limit; judged_h: for false alarms."""

    rate: float
    calibration_h: float
    judged_h: float


class Kept(NamedTuple):
    """Results of one train: `alarms` in `hours`; scores of faults with the usual and this limit."""

    seed: int
    promise: Promise
    alarms: int
    hours: float
    usual: list[Score]
    scores: list[Score]

    @property
    def kept(self) -> bool:
        """Whether there are no more alarms than the rate allows in so many hours."""
        return self.alarms <= self.promise.rate * self.hours / 1000.0


def split(seed: int, world: str, how: Split) -> Kept | None:
    """Results of one train; None with a single motor, which is never judged; a pure function."""
    train, fits = WORLDS[world], FIT_RUNS[BENCH.name]

    def runs(first: int, hours: float) -> Iterator[Record]:
        for n in range(round(hours / RUN_H)):
            yield record_of(train(seed, BENCH, None, first + n, new=True))

    healthy = list(runs(0, fits * RUN_H))
    if healthy[0].motors < 2:
        return None
    fitted = ModelMethod().fit_runs(healthy)
    assert isinstance(fitted, Watching)
    known, dt = fitted.known, spacing(healthy[0])
    held_back = list(runs(FIRST, how.calibration_h))
    peaks = [hourly(ThermalMonitor(known, dt), run) for run in held_back]
    promise = promise_of(hours_of(np.concatenate(peaks)), how.rate)
    limited = known._replace(raise_probability=promise.limit)
    later = list(runs(FIRST + len(held_back), how.judged_h))
    alarms = sum(false_alarms(ThermalMonitor(limited, dt), run) for run in later)
    shared = Shared(healthy)
    faults = [train(seed, BENCH, kind, fits + 1 + n) for n, kind in enumerate(KINDS)]
    usual, scores = (
        [judge(Watching(by), 0.0, fault, BENCH, shared)[0] for fault in faults]
        for by in (known, limited)
    )
    return Kept(seed, promise, alarms, len(later) * RUN_H, usual, scores)


def false_alarms(monitor: ThermalMonitor, record: Record) -> int:
    """Number of times that a fault-free train begins to report something."""
    judged = monitor.known_motors["unexplained"] == 0
    reported = [
        bool((monitor.held | (monitor.offsets != 0.0).any(axis=1))[judged].any())
        for complete in followed(monitor, record)
        if complete
    ]
    return len(stretches(np.array(reported)))


def splits(seeds: Sequence[int], world: str, how: Split, jobs: int = 1) -> Iterator[Kept | None]:
    """Yield the results train by train, in order, computed in `jobs` processes."""
    each = partial(split, world=world, how=how)
    return mapped(each, seeds, jobs)


def report(found: Sequence[Kept]) -> str:
    """Tables for one or more trains: alarms of each, faults found, and how many kept the rate."""
    rows = [
        [
            str(k.seed), "promised" if k.promise.promised else "extrapolated",
            f"{k.promise.limit:.6f}", str(k.alarms), f"{k.hours:g}", "yes" if k.kept else "no",
        ]
        for k in found
    ]  # fmt: skip
    faults = []
    for name, parts in (("0.9", [k.usual for k in found]), ("stated", [k.scores for k in found])):
        every = [score for scores in parts for score in scores]
        m = mean(every)
        count = sum(score.found == 1.0 for score in every)
        faults.append(
            [name, f"{count} of {len(every)}", f"{100.0 * m.graced_fnr:.1f}", f"{m.delay_s:.0f} s"]
        )
    alarms, hours = sum(k.alarms for k in found), sum(k.hours for k in found)
    stated = found[0].promise.rate
    return "\n\n".join([
        table_of(["train", "limit", "probability", "false alarms", "h", "kept"], rows),
        table_of(["limit", "faults found", "graced FNR %", "median delay"], faults),
        f"kept in {sum(k.kept for k in found)} of {len(found)} trains: no more than {stated:g} "
        f"false alarms in 1000 h; over all {alarms} in {hours:g} h, {1000.0 * alarms / hours:.2g} "
        "in 1000 h",
    ])  # fmt: skip
