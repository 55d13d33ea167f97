"""Where a drive's own measured speed contradicts what its currents say.

It sees what currents alone cannot: swapped phases, an aliased speed, a wrong sign, and that a drive
turns to which there is no lock. May know: estimates and measured speeds. May not know: frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dbc.frame import SECOND, Nanos
from gateway.bank import DriveEstimate
from gateway.health import Health

SPEED_TOLERANCE: Final = 0.15
SPEED_TOLERANCE_RAD_S: Final = 5.0
"""At the rotor. The flux may be off by a tenth, and Motion is up to 10 ms old in a slip."""
TICKS: Final = 5
LOCKED_NS: Final = SECOND
"""A rotor that turns is locked to within this, or its currents and voltages are not what they seem:
an open phase, a wrong motor."""
TURNS: Final = 2.0
"""Times the least speed that is observable."""


class Contradiction:
    """State of all drives; `seen` once per drive and tick."""

    def __init__(self, pole_pairs: Sequence[float], min_speed_rad_s: float, tick_ns: Nanos) -> None:
        """min_speed_rad_s: electrical, below it nothing is observable."""
        self.pole_pairs, self.tick_ns = pole_pairs, tick_ns
        self.turning_rad_s = TURNS * min_speed_rad_s
        self.apart = [0] * len(pole_pairs)
        """Ticks in a row that the two speeds have been apart."""
        self.unlocked_ns = [0] * len(pole_pairs)
        """How long each has turned, by its own word, with no lock to it."""

    def seen(self, k: int, estimate: DriveEstimate, measured: float | None) -> bool:
        """True once drive k's speeds have contradicted one another for long enough.

        measured: what the drive says of its rotor, rad/s, None if that is not fresh.
        """
        if self._unlocked(k, estimate, measured or 0.0):
            return True
        # Whatever was found stands until a tracked speed agrees again.
        if measured is not None and estimate.health is Health.TRACKING:
            limit = max(SPEED_TOLERANCE_RAD_S, SPEED_TOLERANCE * abs(measured))
            apart = abs((estimate.speed_rad_s or 0.0) - measured) > limit
            self.apart[k] = self.apart[k] + 1 if apart else 0
        return self.apart[k] >= TICKS

    def _unlocked(self, k: int, estimate: DriveEstimate, measured: float) -> bool:
        """True once fresh currents of a drive that turns have given no lock for `LOCKED_NS`."""
        turns = abs(self.pole_pairs[k] * measured) > self.turning_rad_s
        lost = turns and estimate.health is Health.CONVERGING
        self.unlocked_ns[k] = self.unlocked_ns[k] + self.tick_ns if lost else 0
        return self.unlocked_ns[k] > LOCKED_NS
