"""The noise of the sensors and the error of the motor's data, learnt while the filter runs.

A filter that believes its sensors more than they deserve passes their noise on to the load, five
times what it need be at fifty times the variance. The normalised innovation squared of m = 2
currents has the mean 2 where R is right; R is scaled until it has.

A motor off its data sheet lacks a voltage along q (errors of R_s i_q and psi_f w_e). The filter
takes it for speed, while its angle follows the rotor: innovations, load and speed are off for
good, and jump where samples are missing. The chords' speed is that of a turning vector, whatever
its length; what the filter's speed is beyond it is a voltage psi_f (w - w_chord), which `lean`
integrates. (The innovations do not say it: they are zero where they move the load, not where the
voltage is missing.) Neither in paper `adhesion`.
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
LEAN_TAU_S: Final = 0.5
LEAN_FIRST_TAU_S: Final = 0.15
MOST_RESISTANCE: Final = 0.3
MOST_FLUX: Final = 0.2
"""Relative errors of R_s and psi_f that are taken for possible."""


def scale(now: float, nis: float, dt: float, age: float) -> float:
    """The factor on R after one sample, `dt` s after the last; never below 1.

    `nis`: the sample's normalised innovation squared, computed with the factor `now`; `age`:
    seconds since the filter's start.
    """
    change = min(nis, CLIP) / EXPECTED - 1.0
    tau = min(max(0.25 * age, FIRST_TAU_S), TAU_S)
    return min(max(now * math.exp(change * min(dt / tau, 1.0)), 1.0), MOST)


def lean(now: float, beyond: float, psi_f: float, dt: float, most: float, age: float) -> float:
    """The missing voltage after one sample, `dt` s after the last, V; within `most`.

    beyond: the filter's electrical speed less the chords', rad/s; age: seconds since the filter's
    start, which is as far off as the motor is from its data sheet.
    """
    tau = min(max(age, LEAN_FIRST_TAU_S), LEAN_TAU_S)
    return min(max(now + dt / tau * psi_f * beyond, -most), most)


def most_lean(w_e: float, R_s: float, psi_f: float, I_rated: float) -> float:
    """More than this, V, is no motor off its data sheet."""
    return MOST_RESISTANCE * R_s * I_rated + MOST_FLUX * psi_f * abs(w_e)
