"""What a drive sends slowly, `Motion` and `Status`, as `gateway/core/receive.c` keeps it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import Records
from gateway.core.pairing import drive_inputs

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


RPM: Final = 2.0 * math.pi / 60.0
"""rad/s in one revolution per minute."""


class SlowState(NamedTuple):
    """Last good values, columns of `struct drive_input`, (N,); NaN until the first.

    speed rad/s at the rotor; command and before (the one before that) Nm; irms A; operating: its
    `State` is Operation, or it sends none; command_ns: stamp of the last; steady: it has hardly
    changed since the one before.
    """

    speed: Array
    command: Array
    before: Array
    irms: Array
    operating: NDArray[np.bool_]
    command_ns: Ints
    steady: NDArray[np.bool_]


class Readings(NamedTuple):
    """Measurements of one tick, in order of time, (R,).

    drive, stamp, speed rad/s at the rotor, torque Nm, electrical angle rad, NaN where none is sent.
    """

    drive: Ints
    t_ns: Ints
    speed: Array
    torque: Array
    angle: Array


def state_of(drives: Records) -> SlowState:
    """Columns of these records."""
    return SlowState(
        drives["speed"], drives["command"], drives["previous_command"], drives["irms"],
        drives["operating"].view(np.bool_), drives["command_ns"],
        drives["command_steady"].view(np.bool_),
    )  # fmt: skip


def start(drives: int) -> SlowState:
    """Of so many drives, of which nothing has been received."""
    return state_of(drive_inputs(drives))


def readings(rows: int) -> Readings:
    """Room for so many."""
    drive, t_ns = (np.zeros(rows, dtype=np.int64) for _ in range(2))
    return Readings(drive, t_ns, np.zeros(rows), np.zeros(rows), np.zeros(rows))
