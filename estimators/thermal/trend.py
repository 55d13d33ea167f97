"""How fast a motor grows warmer than the others, and when it is at its limit.

The rules are in `trend.c`; here its record (`struct trend`) is read.
"""

from __future__ import annotations

import math
from typing import Final

from _traction_core import lib

from estimators._core import Records, pointer

SURE: Final = 2.0
"""Standard deviations by which a motor must grow warmer before a time is told."""


def rate_of(trend: Records) -> tuple[float, float] | None:
    """Rate of a (1,) `struct trend` and its deviation, K/h; None before enough was seen."""
    rate = lib.trend_rate_k_h(pointer("struct trend", trend))
    return None if math.isnan(rate) else (rate, math.sqrt(trend["cov"][0, 1, 1]))


def time_to(trend: Records, limit_k: float) -> float | None:
    """Hours until the motor is limit_k warmer than the others; None where it need not come."""
    rate, level = rate_of(trend), float(trend["level_k"][0])
    if rate is None or rate[0] <= SURE * rate[1] or level >= limit_k:
        return None
    return (limit_k - level) / rate[0]
