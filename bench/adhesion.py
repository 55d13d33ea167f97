"""Detection figures: `traction-gateway evaluate` on development and reporting seeds."""

from __future__ import annotations

from gateway.reports.scoring import Score
from gateway.study.evaluation_report import COLUMNS, cells
from gateway.study.evaluation_runs import Plan, evaluate, fitted, judge, one_run, record
from gateway.study.scenarios_family import DEVELOPMENT, REPORTING
from gateway.study.scenarios_random import random_scenario

DETECTORS = ("vb", "median")
HARD = ("majority", "n2", "braking", "rough", "all_together", "large")
"""Families besides single losses; `traction-gateway evaluate --seeds reporting` knows more."""
FEW = tuple(REPORTING)[:20]


def pooled(seeds: range, dbc: str = "traction.dbc", *, healthy: bool = False,
           detector: str = "vb") -> Score:  # fmt: skip
    """Random single losses, all runs of a set together; without their loss if `healthy`."""
    plan = Plan(("single",), (detector,), tuple(seeds), dbc)
    total = Score()
    for seed in seeds:
        if healthy:
            scenario = random_scenario(seed, healthy=True)
            config, codec = fitted(plan, detector, scenario)
            measured = judge(record(scenario, config, codec), config, codec)
        else:
            (measured,) = one_run(plan, "single", seed)
        total = total.plus(measured.flags)
    return total


def rows() -> list[tuple[str, ...]]:
    """A row per set, bus, family and detector; within ten minutes on two cores."""
    single = ("single",)
    sets = (
        ("development", Plan(single, DETECTORS, tuple(DEVELOPMENT))),
        ("reporting", Plan(single, DETECTORS, tuple(REPORTING))),
        ("reporting, FD", Plan(single, DETECTORS[:1], FEW, "traction_fd.dbc")),
        ("reporting, 20 seeds", Plan(HARD, DETECTORS[:1], FEW)),
    )
    return [(name, *cells(line)) for name, plan in sets for line in evaluate(plan, 2)]


HEADER = ("set", *COLUMNS)
