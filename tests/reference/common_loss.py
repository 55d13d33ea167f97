"""Loss of all drives at once in Python, which `gateway/core/common_loss.c` is compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median_low
from typing import Any, Final

from _traction_core import lib

SHARED_ERROR: Final = 0.03
"""Of all loads, as a share of the command."""
MOST_SIGMAS: Final = 2.0
"""A drive that lacks more than the median by as many counts as that: its command may be wrong."""
STANDS: Final = 0.9
LAG_S: Final = 0.01


class CommonLoss:
    """since_s: for how long some of the load that must be there has been missing."""

    def __init__(self) -> None:
        self.since_s = 0.0

    def follow(self, a: Any, alone: Sequence[float], counts: Sequence[int]) -> float:
        """Probability that all lack some of their load; 0 below 0.5.

        a: `Adhesion`; alone: what each says by itself; counts: drives that adhere among themselves.
        """
        each = min((alone[k] for k in counts), default=0.0)
        each = each if 0.5 <= each <= 1.0 else 0.0
        odd = a.rotors["odd_s"] > 0.0
        mine = [a.responses[k] for k in counts if not odd[k]]
        mean = self._mean(mine)
        self.since_s = self.since_s + a.tick_s if mean > STANDS else 0.0
        oldest = max((float(r["command_age_s"]) for r in mine), default=0.0)
        return max(mean, each) if max(oldest, 0.0) + LAG_S + a.tick_s <= self.since_s else each

    @staticmethod
    def _mean(drives: list[Any]) -> float:
        """Probability that they lack something on average."""
        n = len(drives)
        if n < 2:
            return 0.0
        variance = sum(float(r["missing_sigma"]) ** 2 for r in drives)
        shared = SHARED_ERROR * sum(abs(float(r["command"])) for r in drives) / n
        lacks = sorted(float(r["missing"]) for r in drives)
        most = median_low(lacks) + MOST_SIGMAS * math.sqrt(variance / n)
        lack = sum(min(one, most) for one in lacks) / n
        z = -lack / math.sqrt(variance / (n * n) + shared * shared)
        return 0.5 * float(lib.elementary_erfc(z * (1.0 / 1.4142135623730951)))
