"""Enumerations of the message set: reasons, health, flags. Values are the contract's, section 1.

They are defined in `gateway/core/records.h`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from _traction_core import lib

NEVER: Final = -(1 << 63)
"""Value of a time stamp or an age that does not exist."""


class Flag(IntEnum):
    """Antivalent two-bit state; 3 (`Invalid`) is never sent."""

    UNKNOWN = lib.FLAG_UNKNOWN
    GOOD = lib.FLAG_GOOD
    BAD = lib.FLAG_BAD


INVALID: Final = 3
"""The fourth state of a flag's two bits, read as unknown."""


class Reason(IntEnum):
    """Why something is unknown."""

    NONE = lib.REASON_NONE
    STARTING = lib.REASON_STARTING
    STALE = lib.REASON_STALE
    CORRUPTED = lib.REASON_CORRUPTED
    SEQUENCE = lib.REASON_SEQUENCE
    RANGE = lib.REASON_RANGE
    NOT_AVAILABLE = lib.REASON_NOT_AVAILABLE
    DIVERGED = lib.REASON_DIVERGED
    TOO_FEW_DRIVES = lib.REASON_TOO_FEW_DRIVES
    OVERRUN = lib.REASON_OVERRUN
    INTRUDER = lib.REASON_INTRUDER
    CONFIG = lib.REASON_CONFIG


RANKS: Final = tuple(lib.reason_rank(reason) for reason in Reason)
"""Rank by a reason's number: lower is worse. A frame's `Reason` is the worst of unknown drives."""


class Health(IntEnum):
    """State of one drive's estimator."""

    UNKNOWN = lib.HEALTH_UNKNOWN
    CONVERGING = lib.HEALTH_CONVERGING
    TRACKING = lib.HEALTH_TRACKING
    PREDICTING = lib.HEALTH_PREDICTING
    DIVERGED = lib.HEALTH_DIVERGED
    INPUT_INVALID = lib.HEALTH_INPUT_INVALID


class FaultClass(IntEnum):
    """Kind of a thermal or sensor fault."""

    UNKNOWN = lib.FAULT_UNKNOWN
    NONE = lib.FAULT_NONE
    OVERHEATING = lib.FAULT_OVERHEATING
    COOLING_LOSS = lib.FAULT_COOLING_LOSS
    BEARING = lib.FAULT_BEARING
    SENSOR_BIAS = lib.FAULT_SENSOR_BIAS
    SENSOR_STUCK = lib.FAULT_SENSOR_STUCK
    SENSOR_LOST = lib.FAULT_SENSOR_LOST
    WINDING_RESISTANCE = lib.FAULT_WINDING_RESISTANCE


SENSOR_FAULTS: Final = (FaultClass.SENSOR_BIAS, FaultClass.SENSOR_STUCK, FaultClass.SENSOR_LOST)


class FaultSensor(IntEnum):
    """Sensor that has a sensor fault."""

    NONE = lib.FAULT_ON_NONE
    STATOR = lib.FAULT_ON_STATOR
    DRIVE_END = lib.FAULT_ON_DRIVE_END
    NON_DRIVE_END = lib.FAULT_ON_NON_DRIVE_END
    AMBIENT = lib.FAULT_ON_AMBIENT
    CURRENT = lib.FAULT_ON_CURRENT


class GatewayState(IntEnum):
    """`Gateway_Status.State`."""

    STARTING = lib.GATEWAY_STARTING
    RUNNING = lib.GATEWAY_RUNNING
    DEGRADED = lib.GATEWAY_DEGRADED
    SILENT = lib.GATEWAY_SILENT


REJECTED: Final = (
    "error", "repeated", "wrong_sequence", "wrong_length", "not_yet_valid", "not_available",
    "range", "time_back",
)  # fmt: skip
"""Counters of frames with one of our ids whose content was not used."""
