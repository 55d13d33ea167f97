"""When the comparison of loads has nothing to say: wheels that roll, and wheels that grip again.

As `rolls`, `rolls_along`, `has_gripped` and `follow_regrip` in `switching_loss.c`.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

NEAR: Final = 0.03
LITTLE: Final = 0.1
STEADY: Final = 0.02
CUT_OUT: Final = 0.2
LEAST_GRIP: Final = 0.5
MOST_LOSS: Final = 0.1
ROUGH_S: Final = 0.5
HELD_BACK_S: Final = 2.0
SLIDES: Final = 0.05
BACK: Final = 0.9
FASTER: Final = 20
"""So much sooner it ends while the load is back."""


def rolls(rotor: Any) -> bool:
    """Whether a drive, asked for nothing, turns on with the others and carries nothing."""
    slow = abs(rotor["slow_speed"])
    goes_on = abs(rotor["speed"] * rotor["diameter"] - slow) <= STEADY * slow
    return bool(goes_on and turns_freely(rotor))


def turns_freely(rotor: Any) -> bool:
    """Whether a drive carries nothing and turns as fast as the others."""
    near = abs(rotor["creep"]) <= NEAR and abs(rotor["load"]) <= LITTLE
    return bool(near and not rotor["apart"])


def is_cut_out(command: float, previous: float, most: float) -> bool:
    """Whether a drive is asked for next to nothing, and for less than one that follows a flag.

    All per unit of rated torque; most: the largest command of the last seconds.
    """
    coasts = max(abs(command), abs(previous), abs(2.0 * command - previous)) < LITTLE
    return coasts and (most <= LITTLE or abs(command) < CUT_OUT * most)


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


def held_back_s(
    rotor: Any, before: float, demand: float, gap: bool, grips: bool, holds: float, bad: bool,
    tick_s: float,
) -> float:  # fmt: skip
    """Time left, s, in which what a drive lacks may be what its own slip control holds back.

    before: the same a tick ago; gap: its load was not known for long, and now is; grips: it adheres
    by all that is known; holds: probability that it does, by its load; bad: it is flagged.
    """
    known_again = gap and rotor["learnt_s"] >= ROUGH_S
    if known_again or (grips and (bad or (rotor["apart"] and before > 0.0))):
        return HELD_BACK_S
    if rotor["away"] or not math.copysign(1.0, demand or 1.0) * rotor["creep"] <= SLIDES:
        return 0.0
    return max(0.0, before - (FASTER if holds >= BACK else 1) * tick_s)


def apart(known: Any, away: Any, held_s: list[float]) -> Any:
    """(N,) whose load is no measure for the others: wheels that have run away or, while there is
    any other drive, gripped again just now."""
    gripped = np.array(held_s) > 0.0
    return away | (gripped & bool(np.any(known & ~away & ~gripped)))
