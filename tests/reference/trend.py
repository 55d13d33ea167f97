"""How fast a motor grows warmer than the others: degradation, K/h, with its uncertainty.

A local linear trend per motor (Harvey 1989): the level walks, and so does the rate, slowly. What it
looks at is what neither the thermal model nor the other motors explain. Jumps are not part of it:
a level may step, a rate does not (paper `thermal`, eq. (22)-(27), has both, offline).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVEL_K: Final = 0.2
"""Walk of the level in an hour."""
RATE_K_H: Final = 0.005
"""Walk of the rate in an hour, K/h."""
READING_K: Final = 0.5
"""Of a block's deviation: what wanders for a quarter of an hour does not average out."""
JUMP_K: Final = 3.0
"""A deviation further off than this is a jump: the level follows at once, the rate not at all."""
FIRST_RATE_K_H: Final = 1.0
ENOUGH_H: Final = 1.0
"""Of readings, before a rate is told."""
SURE: Final = 2.0
"""Standard deviations by which a motor must grow warmer before a time is told."""


class Trend:
    """M motors; `take` per block of readings."""

    def __init__(self, motors: int) -> None:
        """Nothing is known."""
        self.level, self.rate = np.full(motors, np.nan), np.zeros(motors)
        self.cov = np.tile(np.diag([READING_K**2, FIRST_RATE_K_H**2]), (motors, 1, 1))
        self.hours = np.zeros(motors)

    def take(self, deviation: Array, hours: float) -> None:
        """Deviations (M,) K of a block that is `hours` long; NaN: none, the motor is left out."""
        seen = np.isfinite(deviation)
        first = seen & np.isnan(self.level)
        self.level[first] = deviation[first]
        step = np.array([[1.0, hours], [0.0, 1.0]])
        self.level += hours * self.rate
        noise = np.diag([LEVEL_K**2, RATE_K_H**2]) * hours
        self.cov = step @ self.cov @ step.T + noise
        error = np.where(seen, deviation - self.level, 0.0)
        jumped = seen & (np.abs(error) > JUMP_K)
        self.level[jumped] = deviation[jumped]
        calm = seen & ~jumped
        gain = self.cov[:, :, 0] / (self.cov[:, 0, 0] + READING_K**2)[:, None] * calm[:, None]
        self.level += gain[:, 0] * error
        self.rate += gain[:, 1] * error
        self.cov -= gain[:, :, None] * self.cov[:, None, 0, :]
        self.hours += hours * seen

    def told(self, m: int) -> tuple[float, float] | None:
        """Rate of motor m and its standard deviation, K/h; None before `ENOUGH_H`."""
        if self.hours[m] < ENOUGH_H:
            return None
        return float(self.rate[m]), float(np.sqrt(self.cov[m, 1, 1]))

    def time_to(self, m: int, limit_k: float) -> float | None:
        """Hours until motor m is limit_k warmer than the others; None where it need not come."""
        rate = self.told(m)
        if rate is None or rate[0] <= SURE * rate[1] or self.level[m] >= limit_k:
            return None
        return (limit_k - float(self.level[m])) / rate[0]
