"""When the comparison of loads has nothing to say: wheels that roll, and wheels that grip again.

As `rolls` and `has_gripped` in `switching_loss.c`.
"""

from __future__ import annotations

import math
from typing import Any, Final

NEAR: Final = 0.03
LITTLE: Final = 0.1
STEADY: Final = 0.02
LEAST_GRIP: Final = 0.5
MOST_LOSS: Final = 0.1


def rolls(rotor: Any, load: float) -> bool:
    """Whether a drive, asked for nothing, turns on with the others and carries nothing."""
    slow = abs(rotor["slow_speed"])
    goes_on = abs(rotor["speed"] * rotor["diameter"] - slow) <= STEADY * slow
    near = abs(rotor["creep"]) <= NEAR and abs(load) <= LITTLE
    return bool(goes_on and near and not rotor["apart"])


def grips(
    rotor: Any, load: float, demand: float, adhering: float, lost: float, answers: float
) -> bool:
    """Whether a wheel that was lost just now turns with the others under their load or more.

    adhering, lost: NaN where its load is not compared; answers: probability of a loss by its own
    command, NaN without.
    """
    turns = abs(rotor["creep"]) <= NEAR and not (rotor["away"] or rotor["apart"])
    carries = load * math.copysign(1.0, demand) >= max(abs(demand), LITTLE)
    unlike = adhering < LEAST_GRIP and lost <= MOST_LOSS
    return bool(turns and carries and not answers > MOST_LOSS and (unlike or rotor["above"]))
