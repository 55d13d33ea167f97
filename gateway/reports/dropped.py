"""Share of the input that was dropped, and whether it is too large for a good result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

MOST: Final = 0.01
"""Largest share of the input that may be dropped without a warning."""


def warning(dropped: Mapping[str, int], used: int) -> str:
    """One line with the share that was dropped and the causes; empty up to `MOST` of the input.

    dropped: number of lines or frames by cause; used: number of those that were not dropped.
    """
    causes = {cause: count for cause, count in dropped.items() if count}
    total = sum(causes.values())
    if total <= MOST * (total + used):
        return ""
    words = ", ".join(f"{cause} {count}" for cause, count in sorted(causes.items()))
    share = f"{100.0 * total / (total + used):.1f} %"
    return f"{share} of the input was dropped, which is more than {MOST:.0%}: {words}"
