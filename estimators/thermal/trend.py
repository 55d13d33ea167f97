"""How fast a motor grows warmer than the others, and when it is at its limit.

The rules are in `trend.c`; this module reads its record (`struct trend`).
"""

from __future__ import annotations

import math

from _traction_core import lib

from dbc.records import Records, pointer


def rate_of(trend: Records) -> tuple[float, float] | None:
    """Rate of a (1,) `struct trend` and its standard deviation, K/h; None: too little data."""
    own = pointer("struct trend", trend)
    rate = lib.trend_rate_k_h(own)
    return None if math.isnan(rate) else (rate, lib.trend_sigma_k_h(own))


def time_to(trend: Records, limit_k: float) -> float | None:
    """Hours until the motor is limit_k warmer than the others; None if never, or already."""
    hours = lib.trend_hours_to(pointer("struct trend", trend), limit_k)
    return None if math.isnan(hours) else hours
