"""A stated rate of false `AdhesionLost`, and the time for which evidence must last to keep it.

For every minute of fault-free records, the longest time is measured for which the evidence of any
drive said that adhesion is lost. The k-th largest of these times is a tolerance limit
(`estimators.tolerance`): a flag that is raised later than that is false in no more minutes than the
rate allows. With too few minutes nothing is promised, and the longest of all times is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from estimators.tolerance import BROKEN, needed, order_of

MINUTES: Final = 60_000
"""In 1000 h."""
STEP_MS: Final = 10
"""What is added to a time that evidence has lasted: a step of the detector."""
LATEST_MS: Final = 500
"""A loss that is flagged later than this helps no slip control."""


class Promise(NamedTuple):
    """At most `rate` false alarms in 1000 h, and the time in ms after which a flag is raised.

    promised: whether the minutes guarantee the rate; minutes: those measured; needed: minutes that
    the rate needs; least: lowest rate that the measured minutes could guarantee.
    """

    rate: float
    raise_ms: int
    promised: bool
    minutes: int
    needed: int
    least: float

    def __str__(self) -> str:
        """One line, as it is printed with every run."""
        if self.promised:
            return (
                f"at most {self.rate:g} false alarms in 1000 h, promised by {self.minutes} "
                f"fault-free minutes; raised after {self.raise_ms} ms"
            )
        why = (
            f"{self.needed} fault-free minutes needed, {self.minutes} measured, which can promise "
            f"{self.least:.3g} at best"
            if self.minutes < self.needed
            else f"in fault-free minutes the evidence of a loss lasted for {LATEST_MS} ms and more"
        )
        return (
            f"{self.rate:g} false alarms in 1000 h not promised: {why}; raised after "
            f"{self.raise_ms} ms"
        )


def promise_of(minutes: int, longest_ms: Sequence[int], rate: float) -> Promise:
    """Promise for `rate` false alarms in 1000 h.

    minutes: fault-free ones that were measured, at least one; longest_ms: for the worst of them,
    the longest time in ms that evidence of a loss has lasted, descending, at least one.
    """
    share = -math.expm1(-rate / MINUTES)
    k = order_of(minutes, len(longest_ms), share)
    raise_ms = longest_ms[max(k - 1, 0)] + STEP_MS
    return Promise(
        rate, min(raise_ms, LATEST_MS), k > 0 and raise_ms <= LATEST_MS, minutes, needed(share),
        -MINUTES * math.log(BROKEN) / minutes,
    )  # fmt: skip
