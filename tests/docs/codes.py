"""`python -m tests.docs.codes`: write docs/codes.md, what `traction-gateway explain` prints."""

from pathlib import Path

from gateway.reports import explanations

PAGE = Path(__file__).parents[2] / "docs" / "codes.md"
HEAD = """# Reasons, health, faults

Codes in `Gateway_Adhesion`, `Drive{n}_Estimate` and `Drive{n}_Thermal`: meaning, remedy, example.
In a terminal: `traction-gateway explain 8`, or `explain TooFewDrives`.
"""
EXITS = """
## Exit codes

| code | meaning |
|---|---|
| 0 | success; also `run` and `monitor` stopped by a signal (130 before they are ready) |
| 1 | an expectation failed, or more than 1 % of a log was left out |
| 2 | bad input; `check`: a loss is not found, the log does not fit; `hil`, `sim`: no such bus |
| 3 | inconclusive: `hil` on a bus that this machine could not keep up with |
| 130, 143, 141 | ended by Ctrl-C, SIGTERM, a broken pipe |
"""


def tables():
    """A table for each kind of code."""
    lines = []
    for kind in dict.fromkeys(one.kind for one in explanations.ALL):
        lines += [f"## {kind}", "", "| code | name | meaning | what to do | example |",
                  "|---|---|---|---|---|"]  # fmt: skip
        lines += [
            f"| {int(one.code)} | `{one.name}` | {' | '.join(one[2:])} |"
            for one in explanations.ALL if one.kind == kind
        ]  # fmt: skip
        lines.append("")
    return "\n".join(lines).rstrip("\n")


def page():
    """The whole of it."""
    return f"{HEAD}\n{tables()}\n{EXITS}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
