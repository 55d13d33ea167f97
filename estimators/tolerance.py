"""A stated rate of false alarms, and how often later blocks of time exceed the largest measured.

If blocks are exchangeable, the share of later blocks that exceed the k-th largest of n is
Beta(k, n + 1 - k) distributed, whatever their distribution (Wilks 1941).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

BROKEN: Final = 0.05
"""Share of calibrations whose promise may be broken: one in twenty."""
STORED: Final = 20
"""Number of the largest blocks that are kept."""


class Promise(NamedTuple):
    """At most `rate` false alarms in 1000 h, and the limit that keeps it, in its own unit.

    promised: whether the blocks guarantee the rate; blocks: those measured; needed: blocks that the
    rate needs; least: lowest rate that the measured blocks could guarantee. name: of the blocks;
    shown: the limit in words; certain: why no number of blocks was enough.
    """

    rate: float
    limit: float
    promised: bool
    blocks: int
    needed: int
    least: float
    name: str
    shown: str
    certain: str

    def __str__(self) -> str:
        """One line, as it is printed with every run."""
        if self.promised:
            return (
                f"at most {self.rate:g} false alarms in 1000 h, promised by {self.blocks} "
                f"fault-free {self.name}; {self.shown}"
            )
        why = (
            f"{self.needed} fault-free {self.name} needed, {self.blocks} measured, which can "
            f"promise {self.least:.3g} at best"
            if self.blocks < self.needed
            else self.certain
        )
        return f"{self.rate:g} false alarms in 1000 h not promised: {why}; {self.shown}"


def least_rate(blocks: int, per_1000_h: int) -> float:
    """Lowest rate in 1000 h that so many blocks can guarantee."""
    return -per_1000_h * math.log(BROKEN) / blocks


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
