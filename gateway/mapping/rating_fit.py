"""Check the size of measured currents and torques against the ratings of the motor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from dbc.arrays import Array
from gateway.mapping.fit import LEAST, Finding, Measured
from gateway.settings.motors import Motor

OVERLOAD: Final = 5.0
"""Largest peak as a multiple of the rated value; motors stand about three times for seconds."""
_OUTLIERS: Final = 3
"""Number of largest samples that are not used: they may be spikes."""


def findings(data: Measured, motor: Motor, name: str) -> list[Finding]:
    """Findings: peaks far above the motor's ratings. name: of the motor."""
    return [
        *_peak("current", np.abs(data.current), motor.I_rated, ("I_rated", "A"), name),
        *_peak("torque", np.abs(data.torque), motor.T_rated, ("T_rated", "Nm"), name),
    ]


def _peak(
    what: str, sizes: Array, rated: float, key: tuple[str, str], motor: str
) -> Iterator[Finding]:
    sizes = sizes[np.isfinite(sizes)]
    if len(sizes) < LEAST:
        return
    peak = float(np.partition(sizes, -1 - _OUTLIERS)[-1 - _OUTLIERS])
    if peak > OVERLOAD * rated:
        yield Finding(
            False,
            f"peak {what} {peak:.0f} {key[1]} is {peak / rated:.2g} x {key[0]} of motor {motor}: "
            f"put in the data of your motor, or correct the scale of the {what}",
        )
