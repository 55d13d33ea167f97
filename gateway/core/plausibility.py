"""Implausible currents and `Motion` behind a correct checksum: records. C has the rules.

What is checked, and by which limits, is in `gateway/core/plausibility.c`. May know: numbers.
May not know: frames, clocks, flags.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from dbc.records import PLAUSIBILITY, Records
from gateway.settings.config import Motor

LEAST_STEPS: Final = 10.0
LEAST_SHARE: Final = 0.01
"""An unchanged current is a repeated one if it should have changed by more than both: steps of its
resolution, and per unit of rated current (noise)."""


def checks(motors: Sequence[Motor], step_a: float) -> Records:
    """`plausibility` of every drive; nothing received yet. step_a: resolution of the currents."""
    made = np.zeros(len(motors), PLAUSIBILITY)
    rated_a = np.array([m.I_rated for m in motors])
    made["torque_per_a"] = [m.k_p * m.pole_pairs * m.psi_pm for m in motors]
    made["rated_a"], made["rated_nm"] = rated_a, [m.T_rated for m in motors]
    made["least_change_a"] = np.maximum(LEAST_STEPS * step_a, LEAST_SHARE * rated_a)
    for name in ("speed", "torque", "command"):
        made[name] = np.nan
    return made
