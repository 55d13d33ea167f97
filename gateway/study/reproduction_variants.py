"""Variants that paper `adhesion` mentions beside Table 1: bound, reuse, two observed quantities."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from estimators.detect import paper, paper_vb
from gateway.study.reproduction import STATISTICS, Array, statistics
from gateway.study.reproduction_text import grid, number

BOUND_TOLERANCE: Final = 1e-6
PHI: Final = 0.5


class Variant(NamedTuple):
    """Variant of the paper's VB. value (3, 8): STATISTICS per drive, Nm; sweeps: mean of ticks."""

    name: str
    value: Array
    sweeps: float


def variants(load: Array, speed: Array) -> list[Variant]:
    """Results of VB as in Table 1, and of the variants that the paper mentions.

    load (T, N) Nm, speed (T, N) rad/s electrical. D = 2 observes both; `reuse` is section 5's
    flattened posterior (`paper_vb.flatten`, phi PHI); the bound (18) as the stopping rule ends the
    sweeps once it grows by less than BOUND_TOLERANCE.
    """
    x, preset = paper.observations(load, None, paper.Observe.TORQUE)
    prior = paper_vb.paper_prior(preset)
    both, preset_2 = paper.observations(load, speed, paper.Observe.BOTH)
    found = {
        f"D = 1, {paper.SWEEPS} sweeps (Table 1)": paper_vb.infer(x, prior),
        f"stopped by the bound ({BOUND_TOLERANCE:g})": paper_vb.infer(
            x, prior, sweeps=paper.MOST_SWEEPS, tolerance=BOUND_TOLERANCE
        ),
        "reuse": paper_vb.infer_reusing(x, prior, PHI),
        "D = 2, load and speed": paper_vb.infer(both, paper_vb.paper_prior(preset_2)),
    }
    return [
        Variant(
            name, np.array([statistics(one) for one in (load - q.common[:, None]).T]),
            float(np.mean(q.sweeps)),
        )
        for name, q in found.items()
    ]  # fmt: skip


def section(found: list[Variant]) -> list[str]:
    """Section of the report."""
    rows = [
        [one.name, f"PMSM{drive}", *(number(v) for v in values), number(one.sweeps, 1)]
        for one in found
        for drive, values in enumerate(one.value.tolist(), 1)
    ]
    return [
        "## Variants of VB",
        "What the paper mentions without a table of it: more sweeps until the bound (18) stands, "
        "the flattened posterior of the last instant as the next prior (section 5), load and speed "
        'observed together (D = 2, priors of section 5). `[adhesion] detector = "paper_vb"` has '
        "them as `tolerance`, `reuse` and `observe`.",
        grid(("VB", "drive", *STATISTICS, "sweeps"), rows),
    ]
