"""Detection figures: `traction-gateway evaluate` on development and reporting seeds."""

from __future__ import annotations

from gateway.study.evaluation_report import COLUMNS, cells
from gateway.study.evaluation_runs import Plan, evaluate
from gateway.study.scenarios_family import DEVELOPMENT, REPORTING

HEADER = ("set", *COLUMNS)
DETECTORS = ("vb", "median")
HARD = ("majority", "n2", "braking", "rough", "all_together", "large")
"""Families besides single losses; `traction-gateway evaluate --seeds reporting` knows more."""
FEW = tuple(REPORTING)[:20]


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
