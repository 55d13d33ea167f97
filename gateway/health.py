"""Words of the message set: reasons, health, flags. Values are the contract's, section 1."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final

from _traction_core import lib

NEVER: Final = -(1 << 63)
"""In place of a stamp, or an age, that there is not."""


class Flag(IntEnum):
    """Antivalent two-bit state; 3 (`Invalid`) is never sent."""

    UNKNOWN = 0
    GOOD = 1
    BAD = 2


class Reason(IntEnum):
    """Why something is unknown."""

    NONE = 0
    STARTING = 1
    STALE = 2
    CORRUPTED = 3
    SEQUENCE = 4
    RANGE = 5
    NOT_AVAILABLE = 6
    DIVERGED = 7
    TOO_FEW_DRIVES = 8
    OVERRUN = 9
    INTRUDER = 10
    CONFIG = 11


PRIORITY = tuple(Reason(n) for n in (11, 10, 9, 3, 4, 5, 7, 2, 6, 8, 1))
"""Highest first; the frame's `Reason` is the first of these that any unknown drive has."""

RANKS: Final = tuple((*PRIORITY, Reason.NONE).index(reason) for reason in Reason)
"""Of a reason's number: lower is worse."""


def worst(reasons: Sequence[Reason]) -> Reason:
    """The reason of highest priority; NONE of none."""
    found = Reason.NONE
    for reason in reasons:
        if reason is not found and RANKS[reason] < RANKS[found]:
            found = reason
    return found


class Health(IntEnum):
    """State of one drive's estimator."""

    UNKNOWN = 0
    CONVERGING = 1
    TRACKING = 2
    PREDICTING = 3
    DIVERGED = 4
    INPUT_INVALID = 5


class FaultClass(IntEnum):
    """What kind of thermal or sensor fault."""

    UNKNOWN = lib.FAULT_UNKNOWN
    NONE = lib.FAULT_NONE
    OVERHEATING = lib.FAULT_OVERHEATING
    COOLING_LOSS = lib.FAULT_COOLING_LOSS
    BEARING = lib.FAULT_BEARING
    SENSOR_BIAS = lib.FAULT_SENSOR_BIAS
    SENSOR_STUCK = lib.FAULT_SENSOR_STUCK
    SENSOR_LOST = lib.FAULT_SENSOR_LOST
    WINDING_RESISTANCE = lib.FAULT_WINDING_RESISTANCE


class FaultSensor(IntEnum):
    """Which sensor a sensor fault is on."""

    NONE = lib.FAULT_SENSOR_NONE
    STATOR = lib.FAULT_SENSOR_STATOR
    DRIVE_END = lib.FAULT_SENSOR_DRIVE_END
    NON_DRIVE_END = lib.FAULT_SENSOR_NON_DRIVE_END
    AMBIENT = lib.FAULT_SENSOR_AMBIENT
    CURRENT = lib.FAULT_SENSOR_CURRENT


class GatewayState(IntEnum):
    """`Gateway_Status.State`."""

    STARTING = 1
    RUNNING = 2
    DEGRADED = 3
    SILENT = 4


def summary(flags: Sequence[Flag]) -> Flag:
    """One flag for a set of drives: bad if any is bad, else unknown if any is, else good."""
    if Flag.BAD in flags:
        return Flag.BAD
    return Flag.GOOD if flags and Flag.UNKNOWN not in flags else Flag.UNKNOWN


REJECTED: Final = (
    "error",
    "repeated",
    "wrong_sequence",
    "wrong_length",
    "not_yet_valid",
    "not_available",
    "range",
    "time_back",
)
"""Counters of frames with one of our ids whose content was not used."""
