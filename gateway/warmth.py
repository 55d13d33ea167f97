"""What is remembered of all motors' temperatures, as arrays for the compiled loops.

N drives of P sensors each: stator, drive end, non-drive end. May know: findings. May not know:
frames, clocks, what a calibration or a thermal model is.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import Records
from gateway.health import NEVER, FaultClass, FaultSensor, Flag, Reason
from gateway.said import Findings, findings

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Seconds(NamedTuple):
    """Sums of a second, (N, P + 3): the points, squared current A^2, speed rad/s, ambient degC.

    number: how many there are of each; mean: of the last second that was complete, NaN where there
    was none; ambient (N,): as last sent, NaN if not valid; every: temperature cycles in a second.
    """

    total: Array
    number: Array
    mean: Array
    ambient: Array
    every: int


class Averages(NamedTuple):
    """MAISD of the temperatures, see `estimators.maisd`.

    configured (N, P): which drive has which sensor; value (N, P): last valid values, degC;
    ring (s, N, P); mean, known, believed, centred, deviation (N, P), the latter two of means less
    offset over gain; spread (P,): the MAISD; limit_k, apart_k (P,): of spread and deviation;
    number (N, P), ranked (N,): room.
    """

    configured: Bools
    value: Array
    ring: Array
    mean: Array
    number: Ints
    known: Bools
    believed: Bools
    centred: Array
    deviation: Array
    spread: Array
    gain: Array
    offset: Array
    limit_k: Array
    apart_k: Array
    ranked: Array


class Model(NamedTuple):
    """What the thermal model says of every motor, (N,): as `Findings`.

    sensor: `AS_IT_IS` where it says nothing of the sensors.
    """

    thermal: Ints
    sensor: Ints
    reason: Ints
    fault_class: Ints
    fault_sensor: Ints
    rate_k_h: Array
    jumps: Ints


class Method(IntEnum):
    """How motors are judged."""

    UNCALIBRATED = 0
    MAISD = 1
    MODEL = 2


class Beat(IntEnum):
    """Index into `Warmth.beat`: where the temperature cycles are."""

    NEXT_NS = 0
    """When the windows advance next; `NEVER` before the first reading."""
    CYCLES = 1
    """So many times they have."""
    AT = 2
    """Of them, in this second."""
    FULL = 3
    """Whether the last one completed a second."""
    STIRRED = 4
    """Something came since reports were last told."""
    UNTIL_NS = 5
    """When the first of them is to be told anew, though nothing comes."""


AS_IT_IS = -1


class Warmth(NamedTuple):
    """All of it. beat (6,): see `Beat`; period_ns: the temperatures' cycle; method: `Method`.

    drives (N,): their sensors, `struct temperature_drive`;
    kept: reports as last judged, kept_ns (N,): until when they stand; fresh (N,): the drive's
    temperatures are within their limit, as last told.
    """

    drives: Records
    seconds: Seconds
    averages: Averages
    model: Model
    kept: Findings
    kept_ns: Ints
    fresh: Bools
    beat: Ints
    period_ns: int
    method: int


def seconds(drives: int, width: int, every: int) -> Seconds:
    """width: P + 3; every: temperature cycles in a second."""
    total, number = np.zeros((2, drives, width))
    return Seconds(
        total, number, np.full((drives, width), np.nan), np.full(drives, np.nan), every
    )  # fmt: skip


def averages(
    configured: Bools, ring: Array, gain: Array, offset: Array, limit_k: Array, apart_k: Array
) -> Averages:  # fmt: skip
    """Around an empty window, ring (s, N, P)."""
    shape = ring.shape[1:]
    (drives, width) = shape
    known, believed = (np.zeros(shape, dtype=np.bool_) for _ in range(2))
    number = np.zeros(shape, dtype=np.int64)
    return Averages(
        configured, np.zeros(shape), ring, np.zeros(shape), number, known, believed,
        np.zeros(shape), np.full(shape, np.nan), np.full(width, np.nan), gain, offset, limit_k,
        apart_k, np.zeros(drives),
    )  # fmt: skip


def model(drives: int) -> Model:
    """No motor has been judged."""

    def each(value: int) -> Ints:
        return np.full(drives, value, dtype=np.int64)

    return Model(
        each(Flag.UNKNOWN), each(AS_IT_IS), each(Reason.STARTING), each(FaultClass.UNKNOWN),
        each(FaultSensor.NONE), np.full(drives, np.nan), each(0),
    )  # fmt: skip


def warmth(
    drives: Records, seconds: Seconds, averages: Averages, period_ns: int, method: Method
) -> Warmth:
    """Of parts in which there is nothing yet."""
    motors = len(drives)
    beat = np.zeros(len(Beat), dtype=np.int64)
    beat[Beat.NEXT_NS], beat[Beat.STIRRED] = NEVER, True
    return Warmth(
        drives, seconds, averages, model(motors), findings(motors),
        np.full(motors, NEVER, dtype=np.int64), np.zeros(motors, dtype=np.bool_), beat, period_ns,
        int(method),
    )  # fmt: skip
