"""What a drive sends slowly, `Motion` and `Status`, as arrays for the compiled receive loop."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


RPM: Final = 2.0 * math.pi / 60.0
"""rad/s in one revolution per minute."""
STEADY_NM: Final = 0.5
STEADY_SHARE: Final = 0.05
"""A command that moved less between two Status frames is steady: 5 % and the wire's noise."""


class Count(IntEnum):
    """Index into `SlowState.came`."""

    READINGS = 0
    CHANGED = 1


class SlowState(NamedTuple):
    """Last good values, a row per drive; NaN until the first.

    speed rad/s at the rotor; command and before (the one before that) Nm; irms A; operating: its
    `State` is Operation, or it sends none;
    command_ns: stamp of the last; steady: it has hardly changed since the one before. came (2,):
    how many readings in this tick, and how much of anything.
    """

    speed: Array
    command: Array
    before: Array
    irms: Array
    operating: NDArray[np.bool_]
    command_ns: Ints
    steady: NDArray[np.bool_]
    came: Ints


class Readings(NamedTuple):
    """Measurements of one tick, in order of time, (R,).

    drive, stamp, speed rad/s at the rotor, torque Nm, electrical angle rad, NaN where none is sent.
    """

    drive: Ints
    t_ns: Ints
    speed: Array
    torque: Array
    angle: Array


def start(drives: int) -> SlowState:
    """Nothing received yet."""
    speed, command, before, irms = (np.full(drives, np.nan) for _ in range(4))
    return SlowState(
        speed, command, before, irms, np.ones(drives, dtype=np.bool_),
        np.zeros(drives, dtype=np.int64), np.ones(drives, dtype=np.bool_),
        np.zeros(len(Count), dtype=np.int64),
    )  # fmt: skip


def readings(rows: int) -> Readings:
    """Room for so many."""
    drive, t_ns = (np.zeros(rows, dtype=np.int64) for _ in range(2))
    return Readings(drive, t_ns, np.zeros(rows), np.zeros(rows), np.zeros(rows))
