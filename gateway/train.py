"""The train as all its rotors and commands show it together, before any drive is judged.

- **Acceleration**: that of the median rotor, never of the wheel that is judged; of two the slower
  in traction, the faster in braking. A load is credited with what its own rotor takes of it.
- **Speed**: a rotor more than `MOST_CREEP` from the median of the others is never `Adhering`. Wheel
  diameters are learnt, to within `MOST_DIAMETER`.
- **Commands**: a load that no command asks for, and a command far from all others' beside a load
  that is not, are errors of the `Status` message: no loss follows from them, and no health.
- **State**: a drive that is not in Operation is not judged.

May know: numbers. May not know: frames, clocks. Not in paper `adhesion`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.config import Motor
from gateway.health import NEVER

ACCELERATION_TAU_S: Final = 0.5
"""Time constant of a rotor's acceleration."""
MOST_ACCELERATION_TORQUE: Final = 0.15
"""Per unit of rated torque: an emergency brake of 1.5 m/s^2 for the 350 kW motor, the wheelset
behind its gear included."""
ROTATING_SHARE: Final = 0.08
ROTATING_FLOOR: Final = 0.02
"""And never more than this share of the load, plus a hill's part per unit of rated torque: what
turns is a few percent of a train's inertia. All wheels that run away together need more."""
SINGLE_CREDIT: Final = 0.05
"""Per unit of rated torque: a drive without others that accelerates by more may be running away."""
SINGLE_CHANGE: Final = 0.3
"""And one that is so far from its own speed of late, as a share of it; a train of 1 m/s^2 is beyond
1.7 m/s when it is not."""
LEAST_SPEED_RAD_S: Final = 3.0
"""At the rotor; below it a share of the speed says nothing."""
SPEEDS_APART: Final = 0.05
SPEEDS_APART_RAD_S: Final = 1.0
"""A speed by the currents that differs by more from `Motion`, at the rotor, is no measure for
others; `Motion` is up to 10 ms old."""
FOLLOWED_S: Final = 0.2
"""A speed by the currents that has been followed for less, or that is in doubt, may be a guess:
beyond `LEARN_CREEP` from it, `Motion` goes before it."""
MOST_CREEP: Final = 0.08
"""Of a rotor against the others, which creep by one or two percent themselves: together 10 %."""
MOST_APART: Final = 0.1
"""The same while its diameter is not known yet, diameters included."""
NEAR_S: Final = 0.1
"""A rotor that was further away is back after so long: one that turns backwards passes by."""
SLIDES_S: Final = 0.2
"""A rotor that is apart and carries more than the others for so long slides under its load; one
that loses or finds its grip is sooner through."""
GRIPS: Final = 0.1
"""Per unit of rated torque that one which has run away carries more than the others: at once."""
ALONE_S: Final = 0.15
"""A rotor that all others have left is compared with its own speed before that for so long. Longer
would break the rule that a rotor 10 % from the others is `Adhering` for 200 ms at most."""
AGAINST: Final = 0.25
"""Share of the others' load that one which is apart carries against them: it turns backwards."""
LEARN_CREEP: Final = 0.03
"""Diameters are learnt while a rotor is no further than this from where it is expected."""
DIAMETER_FIRST_S: Final = 3.0
"""Of adhering; until then any diameter is expected."""
DIAMETER_TAU_S: Final = 60.0
"""Then so slowly: a slip that grows over seconds is no diameter."""
MOST_DIAMETER: Final = 0.06
UNCOMMANDED: Final = 0.12
UNCOMMANDED_RELATIVE: Final = 0.15
"""A load beyond the command, per unit of rated torque and of the command, that no motor data off
their sheet explain."""
COMMAND_LATE_S: Final = 0.3
"""For so long: a command is up to 0.1 s old, and a drive follows it with a ramp of its own."""
FACTOR: Final = 2.0
FACTOR_FLOOR: Final = 0.1
"""A command is odd beyond this factor from the median of the others and 0.1 of rated torque."""
LOAD_NEAR: Final = 0.25
LOAD_NEAR_FLOOR: Final = 0.05
"""While its load is this near to the median of the others: relative, per unit of rated torque."""
ODD_S: Final = 0.15
MOST_COMMAND: Final = 3.0
"""Per unit of rated torque; no drive delivers more."""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


class Train(NamedTuple):
    """Memory of N drives, (N,), NaN where a number is not known.

    rated Nm, inertia kg m2, motor: which of them have equal ratings; slow_speed: smoothed speed of
    the rotor, rad/s; taken: what accelerates it with its train, per unit of rated torque;
    diameter: of the wheel over the others', as speeds, learnt for learnt_s; creep: as last found;
    followed_s: for how long its currents have been followed; alone_s: for how long all others have
    been away; far: beyond `MOST_APART` while diameters are not known; apart: beyond `MOST_CREEP`
    when that was last known, near_s: for how long it has not been, slides_s: for how long it has
    carried more than the others meanwhile; away: left the others for the side that the effort
    takes it to, and is not back yet; uncertain: it may be running away, or braked by something
    else; doubt_ns: until then its currents accuse nobody; uncommanded_s, odd_s: for how long, odd:
    too long; above: carries more than its command and than the others, in this tick; speed, load,
    rank: of one tick.
    """

    rated: Array
    inertia: Array
    motor: Ints
    slow_speed: Array
    taken: Array
    diameter: Array
    learnt_s: Array
    creep: Array
    followed_s: Array
    alone_s: Array
    far: Flags
    apart: Flags
    near_s: Array
    slides_s: Array
    away: Flags
    uncertain: Flags
    doubt_ns: Ints
    uncommanded_s: Array
    odd_s: Array
    odd: Flags
    above: Flags
    speed: Array
    load: Array
    rank: Array


def start(motors: Sequence[Motor]) -> Train:
    """Nothing known. Speeds are compared between drives whose motors have the same ratings.

    What was measured on each motor, such as its flux, may differ.
    """
    n = len(motors)
    ratings = [(m.pole_pairs, m.T_rated, m.I_rated) for m in motors]
    kinds = list(dict.fromkeys(ratings))
    unknown = np.full((5, n), np.nan)
    far, apart, away, uncertain, odd, above = np.zeros((6, n), dtype=np.bool_)
    doubt_ns = np.full(n, NEVER, dtype=np.int64)
    return Train(
        np.array([m.T_rated for m in motors]), np.array([m.J for m in motors]),
        np.array([kinds.index(m) for m in ratings], dtype=np.int64), unknown[0], np.zeros(n),
        np.ones(n), np.zeros(n), unknown[1], np.zeros(n), np.zeros(n), far, apart, np.zeros(n),
        np.zeros(n), away, uncertain, doubt_ns, np.zeros(n), np.zeros(n), odd, above, unknown[2],
        unknown[3], unknown[4],
    )  # fmt: skip
