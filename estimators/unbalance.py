"""Offsets and unlike gains of the current sensors, learnt while the rotor turns.

In healthy steady state the currents are one vector that turns, i = I e^(j theta) in the stationary
frame (complex alpha + j beta). Sensors make of it, to first order in their errors,

    z = i + n conj(i) + o        o: offset; n: image, from gains that differ between the phases

(the gain that all have in common shows nowhere but in the load, whose ratio is learnt). Over
whole revolutions i, i^2 and conj(i) have the mean zero, so

    o = <z>,   n = (<z^2> - o^2) / (2 (<|z|^2> - |o|^2)).

The means are weighted by a triangle over two revolutions, so that a current that grows or fades
evenly leaves nothing. A pair of revolutions counts if their mean squares agree: a load that steps
would look like an offset. What is larger than sensors are off is not learnt: an open phase is a
fault, not a gain. With two sensors (CAN FD), gains d apart make |n| = d / sqrt(3); left as it is,
the load ripples with twice the electrical frequency. Not in paper `adhesion`.

With a phase open the current swings on one line: <z^2 / |z|^2> has the length 1, not 0. That needs
no model and few samples per revolution: it is judged where the filters do not reach, too.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Ints = NDArray[np.int64]

REVOLUTIONS: Final = 16
"""Memory in the long run; a mean until then."""
MOST_STEP: Final = 0.63
"""Largest turn between two samples, rad: ten a revolution."""
STEADY: Final = 0.1
"""Relative change of the mean square between two revolutions that are steady."""
LEAST: Final = 0.2
"""Per unit of rated current: with less, noise and offsets hide the image."""
MOST_OFFSET: Final = 0.05
"""Per unit of rated current; more is a fault."""
MOST_IMAGE: Final = 0.08
LEAST_VARIANCE: Final = 0.5
"""Share of the mean square that must be variance; the rest is an offset, whose square is less than
a tenth where it may be learnt."""
LINE_S: Final = 0.012
"""Time constant of the mean that tells a line from a circle: before a flag is raised."""
LINE_TURN: Final = 3.0
"""Least angle, rad, that a rotor turns within that for the mean to tell."""
LINE_STEP: Final = 2.5
"""Largest turn between two samples, rad: at half a revolution all samples lie on one line."""
LINE_LEAST: Final = 0.1
"""Per unit of rated current; offsets draw a line from less."""
ON_LINE: Final = 0.5
"""Mean of e^(2j angle): 1 on a line, 1 / (2 LINE_TURN) at most of a current that turns."""
OFF_LINE: Final = 0.3
"""The current turns again."""
ENOUGH: Final = 0.75
"""Share of samples with a current to judge by."""
FOLLOW_S: Final = 0.05
"""What is taken off follows what is learnt: a step would look like one of the load."""


class Unbalance(NamedTuple):
    """Memory of N drives.

    offset (N,) A, image (N,): as learnt from `turns` (N,) revolutions; offset_now, image_now (N,):
    as taken off; of the revolution under way: turned (N,) rad, flat, rising (N, 3): integrals over
    the angle of z, z^2, |z|^2, evenly and with a weight that rises from 0 to 1; before (N, 3):
    `rising` of the revolution before; square (N,): its mean square, A^2, 0 none; line, seen (N,):
    means of z^2 / |z|^2 and of 1 over `LINE_S`, small currents count less; step_s (N,): time
    between the last two samples; on_line (N,): as last judged.
    """

    offset: Complex
    image: Complex
    offset_now: Complex
    image_now: Complex
    turns: Ints
    turned: Array
    flat: Complex
    rising: Complex
    before: Complex
    square: Array
    line: Complex
    seen: Array
    step_s: Array
    on_line: NDArray[np.bool_]


def start(n: int) -> Unbalance:
    """Nothing learnt: the sensors are what they should be."""
    one, three = np.zeros(n, dtype=np.complex128), np.zeros((n, 3), dtype=np.complex128)
    return Unbalance(
        one.copy(), one.copy(), one.copy(), one.copy(), np.zeros(n, dtype=np.int64), np.zeros(n),
        three.copy(), three.copy(), three.copy(), np.zeros(n),
        one.copy(), np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.bool_),
    )  # fmt: skip


def forget(state: Unbalance, k: int) -> None:
    """Drive `k` begins anew."""
    for array in state:
        array[k] = 0


def on_line(state: Unbalance, k: int, w_e: float) -> bool:
    """Whether the current of drive `k` swings on one line although its rotor turns.

    w_e: electrical speed, rad/s, as somebody else measures it. What cannot be judged, for lack of
    speed or of current, stays as it was.
    """
    slow, fast = LINE_TURN / LINE_S, LINE_STEP / max(state.step_s[k], 1e-9)
    seen = state.seen[k]
    if slow <= abs(w_e) <= fast and seen >= ENOUGH:
        limit = OFF_LINE if state.on_line[k] else ON_LINE
        state.on_line[k] = abs(state.line[k]) > limit * seen
    return bool(state.on_line[k])
