"""Seconds and degradation of the motors, as reports and calibrations read them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND

Array = NDArray[np.float64]

SAMPLE_NS: Final = SECOND
"""Readings that come faster are averaged."""


class Sample(NamedTuple):
    """Means of a second: temperature (M, 3) degC, square (M,) A^2, speed, ambient; NaN: unknown."""

    temperature: Array
    square: Array
    speed: Array
    ambient: Array


class Wear(NamedTuple):
    """How a motor grows warmer than the others.

    rate_k_h, sigma_k_h: None before enough was seen; hours: until it is at its limit, None if it
    need not come; jumps: steps of its sensors.
    """

    rate_k_h: float | None = None
    sigma_k_h: float | None = None
    hours: float | None = None
    jumps: int = 0
