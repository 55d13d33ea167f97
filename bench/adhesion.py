"""Detection figures: `traction-gateway evaluate` on development and reporting seeds."""

from __future__ import annotations

from gateway.drivers.evaluation import Plan, evaluate, fitted, judge, one_run, record
from gateway.results.evaluation_report import COLUMNS, cells
from gateway.results.scoring import Score
from sim.families import DEVELOPMENT, FAMILIES, REPORTING
from sim.random_runs import random_scenario

DETECTORS = ("vb", "median")
FEW = ("single", "majority", "rough", "all_together")
HOUR = range(2000, 2180)
"""Seeds of healthy driving, 20 s each."""


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
    """A row per set, motor, bus, family and detector."""
    everything = tuple(FAMILIES)
    sets = (
        ("development", Plan(("single", "rough"), DETECTORS, tuple(DEVELOPMENT))),
        ("reporting", Plan(everything, DETECTORS, tuple(REPORTING))),
        ("reporting, FD", Plan(FEW, DETECTORS[:1], tuple(REPORTING), "traction_fd.dbc")),
        ("reporting, 350 kW", Plan(FEW, DETECTORS[:1], tuple(REPORTING), motor="traction_350kw")),
        ("an hour of healthy driving", Plan(("healthy_hard",), DETECTORS[:1], tuple(HOUR))),
    )
    return [(name, *cells(line)) for name, plan in sets for line in evaluate(plan, 2)]


HEADER = ("set", *COLUMNS)
