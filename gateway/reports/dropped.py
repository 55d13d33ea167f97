"""How much of the input was left out, and whether that is too much for a good result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

MOST: Final = 0.01
"""Share of the input that may be dropped."""


def warning(dropped: Mapping[str, int], used: int) -> str:
    """One line that says how much was dropped and why; empty up to `MOST` of the input.

    dropped: cause -> lines or frames; used: those that were not.
    """
    causes = {cause: count for cause, count in dropped.items() if count}
    total = sum(causes.values())
    if total <= MOST * (total + used):
        return ""
    words = ", ".join(f"{cause} {count}" for cause, count in sorted(causes.items()))
    share = f"{100.0 * total / (total + used):.1f} %"
    return f"{share} of the input was dropped, which is more than {MOST:.0%}: {words}"
