"""Check whether a stated rate of false adhesion flags is kept, in other minutes than its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Ints
from estimators.adhesion_promise import promise_of
from estimators.tolerance import Promise
from gateway.core.gateway import Gateway
from gateway.settings.config import ConfigError
from gateway.study.evaluation_runs import Plan, fitted, recorded
from gateway.study.fault_free import Evidence, at_once, largest
from gateway.study.thermal_scores import table_of

SPLITS: Final = 20


class Kept(NamedTuple):
    """Result of one split: `alarms` in `minutes`, none of which has set the time of the flag."""

    promise: Promise
    alarms: int
    minutes: int

    @property
    def kept(self) -> bool:
        """Whether there are no more alarms than the rate allows in so many minutes."""
        return self.alarms <= self.promise.rate * self.minutes / 60_000.0


def measured(plan: Plan, after_run: Callable[[], None] = lambda: None) -> Ints:
    """(M,) longest evidence of a loss in each minute of the plan's runs, ms; one detector.

    Raises ConfigError for a family in which adhesion is lost.
    """
    evidence = Evidence()
    for family in plan.families:
        for seed in plan.seeds:
            recording = recorded(plan, family, seed)
            if any(row.lost for row in recording.truth):
                raise ConfigError("--false-alarms", [f"adhesion is lost in family {family!r}"])
            given, codec = fitted(plan, plan.detectors[0], recording.scenario, recording.variation)
            config = at_once(given)
            gateway = Gateway(config, codec, 0)
            evidence.begin_log(0)
            for tick, block in enumerate(recording.blocks):
                gateway.step(block, tick * config.loop.period_ns)
                if gateway.changed:
                    evidence.follow_flags(gateway)
            evidence.end_log(gateway.now_ns)
            after_run()
    return evidence.longest_ms


def splits(longest_ms: Ints, rate: float, seed: int = 0) -> list[Kept]:
    """`SPLITS` random halves: one half sets the time of the flag, the other is judged.

    longest_ms: at least two minutes.
    """
    rng, half, found = np.random.default_rng(seed), len(longest_ms) // 2, []
    for _ in range(SPLITS):
        mixed = rng.permutation(longest_ms)
        promise = promise_of(half, largest(mixed[:half]), rate)
        judged = mixed[half:]
        found.append(Kept(promise, int((judged >= promise.limit).sum()), len(judged)))
    return found


def report(found: list[Kept]) -> str:
    """Table of the splits, and how many kept the rate."""
    rows = [
        [
            str(k + 1), "yes" if one.promise.promised else "no", f"{one.promise.limit:g}",
            str(one.alarms), str(one.minutes), "yes" if one.kept else "no",
        ]
        for k, one in enumerate(found)
    ]  # fmt: skip
    return "\n\n".join([
        table_of(["split", "promised", "raised after ms", "false alarms", "min", "kept"], rows),
        f"kept in {sum(one.kept for one in found)} of {len(found)} splits: no more than "
        f"{found[0].promise.rate:g} false alarms in 1000 h",
    ])  # fmt: skip
