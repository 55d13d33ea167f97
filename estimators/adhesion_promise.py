"""A stated rate of false `AdhesionLost`, and the time for which evidence must last to keep it.

For every minute of fault-free records, the longest time is measured for which the evidence of any
drive said that adhesion is lost. The k-th largest of these times is a tolerance limit
(`estimators.tolerance`): a flag that is raised later than that is false in no more minutes than the
rate allows. With too few minutes nothing is promised, and the longest of all times is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from estimators.tolerance import Promise, least_rate, needed, order_of

MINUTES: Final = 60_000
"""In 1000 h."""
STEP_MS: Final = 10
"""What is added to a time that evidence has lasted: a step of the detector."""
LATEST_MS: Final = 500
"""A loss that is flagged later than this helps no slip control."""


def promise_of(minutes: int, longest_ms: Sequence[int], rate: float) -> Promise:
    """Promise for `rate` false alarms in 1000 h; its limit: ms after which a flag is raised.

    minutes: fault-free ones that were measured, at least one; longest_ms: for the worst of them,
    the longest time in ms that evidence of a loss has lasted, descending, at least one.
    """
    share = -math.expm1(-rate / MINUTES)
    k = order_of(minutes, len(longest_ms), share)
    raise_ms = longest_ms[max(k - 1, 0)] + STEP_MS
    limit = min(raise_ms, LATEST_MS)
    return Promise(
        rate, limit, k > 0 and raise_ms <= LATEST_MS, minutes, needed(share),
        least_rate(minutes, MINUTES), "minutes", f"raised after {limit} ms",
        f"in fault-free minutes the evidence of a loss lasted for {LATEST_MS} ms and more",
    )  # fmt: skip
