"""The report on section 5 of paper `adhesion`: Markdown, and the same as one HTML file."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final, NamedTuple

from dbc.arrays import Array
from gateway.reports import page
from gateway.study import reproduction_variants as variants
from gateway.study.reproduction import STATISTICS, Cell, agreement
from gateway.study.reproduction_paths import Comparison
from gateway.study.reproduction_text import grid, name_of, number, rows_of
from gateway.study.reproduction_wire import wire

FIGURES: Final = {
    "figure5": "Figure 5. Variational Bayes.",
    "figure6": "Figure 6. Variational message passing.",
    "figure7": "Figure 7. k-means.",
    "figure8": "Figure 8. Median filtering.",
    "figure9": "Figure 9. Histograms of the differences.",
}
FULL_S: Final = 2.5
PACKAGES: Final = ("traction-gateway", "numpy", "scipy", "matplotlib")


class StandingStart(NamedTuple):
    """A start from standstill: seed; per drive, whether it locked, and its largest excess, Nm."""

    seed: int
    locked: tuple[bool, ...]
    most_nm: tuple[float, ...]


class Outcome(NamedTuple):
    """All results in the report."""

    seed: int
    duration_s: float
    cells: list[Cell]
    rmse: Array
    comparison: Comparison
    zero_locked: tuple[bool, ...]
    starts: list[StandingStart]
    strengths: list[tuple[float, Array]]
    variants: list[variants.Variant]
    networks: list[variants.NetworkRow]


def write(folder: Path, outcome: Outcome) -> None:
    """Write `report.md` and `report.html` beside the figures already there. Raises OSError."""
    page.write(folder, "Section 5 of paper adhesion, reproduced", markdown(outcome), FIGURES)


def markdown(outcome: Outcome) -> str:
    """The whole report."""
    parts = [
        *_head(outcome),
        *_table(outcome),
        *_differences(outcome.cells),
        *_strengths(outcome),
        *variants.section(outcome.variants),
        *variants.network_section(outcome.networks),
        *_starts(outcome),
        *wire(outcome.comparison),
        *_figures(),
        *_assumptions(outcome),
    ]
    return "\n\n".join(parts) + "\n"


def _head(outcome: Outcome) -> list[str]:
    names = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    parts = [
        "# Section 5 of paper `adhesion`, reproduced",
        f"`traction-gateway reproduce adhesion --seed {outcome.seed} -o DIR`; "
        f"Python {platform.python_version()}, {names}.",
        "Three drives, 20000 samples of 125 us, simulated by this project's plant, filtered by its "
        "EKF, judged by its form of the paper's four methods. Drive 1 (PMSM1) loses its load in "
        "samples 500-1500 and 10000-12000 and a part of it in 17000-18000.",
        f"Of Table 1, {agreement(outcome.cells)}; percent of the printed value, "
        "the larger counts. Load error (root mean square) of drives 1 to 3: "
        + ", ".join(number(v) for v in outcome.rmse.tolist())
        + " Nm with the paper's Q.",
    ]
    if outcome.duration_s < FULL_S:
        parts.append(
            f"**Only the first {outcome.duration_s:g} s were run: the comparison does not hold.**"
        )
    return parts


def _table(outcome: Outcome) -> list[str]:
    rows = [
        [
            name_of(row[0]),
            *(
                f"{number(c.ours)} ({number(c.printed)})"
                if c.agrees
                else f"**{number(c.ours)}** ({number(c.printed)})"
                for c in row
            ),
        ]
        for row in rows_of(outcome.cells)
    ]
    return [
        "## Table 1",
        "Statistics of M_z - M_z^(G), Nm: ours (the paper's), **bold** where they do not agree. "
        "Filter: the paper's Q and R at every sample, started at the true state with P = I. "
        "Differences and tolerances: `table1.csv`.",
        grid(("", *STATISTICS), rows),
    ]


def _differences(cells: Sequence[Cell]) -> list[str]:
    reasons: dict[str, list[Cell]] = {}
    for cell in cells:
        if not cell.agrees:
            reasons.setdefault(cell.reason, []).append(cell)
    rows = []
    for reason, members in reasons.items():
        listed: dict[str, list[str]] = {}
        for c in members:
            sign = "+" if c.difference >= 0 else ""
            text = f"{c.statistic} {sign}{number(c.difference)}"
            listed.setdefault(name_of(c), []).append(text)
        where = "; ".join(f"{name} {', '.join(texts)}" for name, texts in listed.items())
        rows.append(f"- {where}\\\n  **Why:** {reason}.")
    if not rows:
        rows = ["Nothing."]
    return [
        "## What does not agree, and why",
        "Ours less the paper's, Nm.",
        "\n".join(rows),
    ]


def _strengths(outcome: Outcome) -> list[str]:
    rows = [
        [f"{beta:g}", *(number(v) for v in values.tolist())] for beta, values in outcome.strengths
    ]
    printed = [c.printed for c in outcome.cells if (c.method, c.drive) == ("paper_vb", 2)]
    return [
        "## Prior strength",
        "VB.PMSM2 with other strengths of the means' prior (beta in (39)); the paper's \"alpha = "
        "beta = 1\" may mean the weight's Beta prior alone. Table 1 above has 1.",
        grid(("beta", *STATISTICS), [*rows, ["the paper", *(number(v) for v in printed)]]),
    ]


def _starts(outcome: Outcome) -> list[str]:
    zero = [
        [f"{name_of(row[0])}", *(number(c.zero_start) for c in row)]
        for row in rows_of(outcome.cells)
    ]
    wrong = [str(d + 1) for d, right in enumerate(outcome.zero_locked) if not right]
    lock = (
        "All three drives lock right."
        if not wrong
        else f"Drive {', '.join(wrong)} ends in a wrong lock, so this table says little."
    )
    right = [s for s in outcome.starts if all(s.locked)]
    rows = [[str(s.seed), *(number(v) for v in s.most_nm)] for s in right]
    most = [max((s.most_nm[k] for s in right), default=0.0) for k in range(3)]
    return [
        "## Start-up",
        "The paper says neither at what state its filter starts nor how fast the drives turn. "
        "Two things were tried to see what that does.",
        "**Started at zero** (all five states 0, P = I) while the drives already turn, same run "
        f"otherwise. {lock}",
        grid(("Started at zero", *STATISTICS), zero),
        f"**Standing starts**: filter at zero, drives from standstill to speed in 0.25 s, "
        f"{len(outcome.starts)} seeds (start angles), median method, first 0.5 s: the most that "
        f"each drive reads above the global estimate, Nm. {len(right)} of {len(outcome.starts)} "
        "lock right on all drives, and these stand below. While they find the rotor single drives "
        f"read too much: which and by how much is the start angles' choice, PMSM1 up to "
        f"{number(most[0])}, PMSM2 {number(most[1])}, PMSM3 {number(most[2])} Nm. The paper's Max "
        "of PMSM1 is 8.76 (median) to 9.74 (VB): a start of that size on that drive is a guess. "
        "The other starts end in a stable wrong state, which the gateway's start by flux "
        "chords prevents.",
        grid(("Seed", "PMSM1", "PMSM2", "PMSM3"), rows),
    ]


def _figures() -> list[str]:
    return [
        "## Figures",
        "Each is there as PNG and as SVG. Shaded: the drive has lost all or a part of its load.",
        *(f"![{text}]({name}.svg)\n\n*{text}*" for name, text in FIGURES.items()),
    ]


def _assumptions(outcome: Outcome) -> list[str]:
    return [
        "## What the paper does not give, and what is used",
        grid(
            ("what", "used"),
            [
                ("motor", "R_s 0.28 ohm, L_s 3.465 mH, psi 0.1989 Wb, 4 pole pairs, J 0.04 kg m2, "
                 "B 0, k_p 1.5"),
                ("speed", "100 rad/s electrical, held by a speed controller over field-oriented "
                 "current control"),
                ("noise of a phase current", "variance 2e-4 A^2, white"),
                ("start", "drives rolling under 10 Nm; angles by seed; filter at the true state, "
                 "P = I (\"low integers\")"),
                ("Q", "diag(0.05, 0.05, 1e-3, 1e-4, 0.1), printed as initial covariance"),
                ("R", "0.01 A^2"),
                ("third window", "-10 sin(pi (t - 17000) / 1000) Nm is added"),
                ("edges of PMSM1's losses", "sharp, from one sample to the next"),
                ("index", "the filter at t uses x(t - 1), u(t - 1), y(t)"),
                ("VB", "beta of the means 1, Beta(1, 1); the preset \"max(M_z)\" is taken over "
                 "the drives at each tick, by magnitude"),
                ("VMP", "order of messages mu, I, pi, Lambda; E[I] starts at 1/2"),
                ("k-means", "starts at the lowest and highest load instead of random points; "
                 "adhering is the larger cluster"),
                ("statistics", "over all samples, start included; quartiles interpolated; s with "
                 "T - 1"),
            ],
            rule="---",
        ),
        "Misprints of the paper and the form used instead: `docs/papers.md`. The reasons above are "
        "what trials speak for; the authors' program is not at hand.",
        f"Files: `table1.csv`, `table1_paths.csv`, {', '.join(f'`{n}.png`' for n in FIGURES)} and "
        f"the same as `.svg`, `section5_fd.log`, `section5_classic.log` (seed {outcome.seed}).",
    ]  # fmt: skip
