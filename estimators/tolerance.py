"""Tolerance limits: how often later blocks of time exceed the largest of measured ones.

If blocks are exchangeable, the share of later blocks that exceed the k-th largest of n is
Beta(k, n + 1 - k) distributed, whatever their distribution (Wilks 1941).
"""

from __future__ import annotations

import math
from typing import Final

BROKEN: Final = 0.05
"""Share of calibrations whose promise may be broken: one in twenty."""
STORED: Final = 20
"""Number of the largest blocks that are kept."""


def order_of(number: int, stored: int, share: float) -> int:
    """Largest k for which the k-th largest of the stored blocks is a tolerance limit; 0: none.

    In at most one calibration of twenty, more than this share of all blocks exceeds such a limit.
    number: blocks measured; stored: of these, the largest that are kept; share: above 0, below 1.
    """
    term = math.exp(number * math.log1p(-share))
    below, k = term, 0
    while below <= BROKEN and k < min(number, stored):
        term *= (number - k) / (k + 1) * share / (1.0 - share)
        k += 1
        below += term
    return k


def needed(share: float) -> int:
    """Fewest blocks of which the largest is a limit that this share of all blocks exceeds."""
    return math.ceil(math.log(BROKEN) / math.log1p(-share))
