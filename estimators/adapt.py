"""The noise of the sensors, learnt from the filter's own innovations.

A filter that believes its sensors more than they deserve passes their noise on to the load, five
times what it need be at fifty times the variance. The normalised innovation squared of m = 2
currents has the mean 2 where R is right; R is scaled until it has. Not in paper `adhesion`.
"""

from __future__ import annotations

import math
from typing import Final

TAU_S: Final = 0.5
FIRST_TAU_S: Final = 0.03
"""A new filter learns faster: with the time that has passed since its start, divided by four."""
MOST: Final = 400.0
"""Variance of the sensors over the configured one; more is a fault, not noise."""
CLIP: Final = 8.0
"""A single innovation counts as at most this: the onset of a loss is no noise."""
EXPECTED: Final = 2.0


def scale(now: float, nis: float, dt: float, age: float) -> float:
    """The factor on R after one sample, `dt` s after the last; never below 1.

    `nis`: the sample's normalised innovation squared, computed with the factor `now`; `age`:
    seconds since the filter's start.
    """
    change = min(nis, CLIP) / EXPECTED - 1.0
    tau = min(max(0.25 * age, FIRST_TAU_S), TAU_S)
    return min(max(now * math.exp(change * min(dt / tau, 1.0)), 1.0), MOST)
