"""`python -m tests.docs.codes`: write docs/codes.md, what `traction-gateway explain` prints."""

from __future__ import annotations

from pathlib import Path

from gateway.reports import explanations

PAGE = Path(__file__).parents[2] / "docs" / "codes.md"
HEAD = """# Reasons, health, faults

What stands in `Gateway_Adhesion`, `Drive{n}_Estimate` and `Drive{n}_Thermal`, why, and what to do.
In a terminal: `traction-gateway explain 8`, or `explain TooFewDrives`.
"""


def page() -> str:
    """The whole of it."""
    return f"{HEAD}\n{explanations.tables()}\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
