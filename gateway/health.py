"""Words of the message set: reasons, health, flags. Values are the contract's, section 1."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final

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

    UNKNOWN = 0
    NONE = 1
    OVERHEATING = 2
    COOLING_LOSS = 3
    BEARING = 4
    SENSOR_BIAS = 5
    SENSOR_STUCK = 6
    SENSOR_LOST = 7
    WINDING_RESISTANCE = 8


class FaultSensor(IntEnum):
    """Which sensor a sensor fault is on."""

    NONE = 0
    STATOR = 1
    DRIVE_END = 2
    NON_DRIVE_END = 3
    AMBIENT = 4
    CURRENT = 5


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
