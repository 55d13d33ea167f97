"""Which signal of the gateway's own messages says what. A new one: a line here, one in `value_of`.

And the tables by which the compiled outbox goes. May know: names of the message set. May not know:
bits, clocks.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.view import Counted


class Source(IntEnum):
    """Where a value comes from: `flags.Status`: of a drive, of the train; or what is counted."""

    ADHESION = 0
    THERMAL = 1
    HEALTH = 2
    SPEED = 3
    LOAD = 4
    LOST = 5
    NIS = 6
    FAULT_CLASS = 7
    FAULT_SENSOR = 8
    MIXED = 9
    MAISD = 10
    RATE = 11
    JUMPS = 12
    ADHESION_REASON = 13
    FAULTS_REASON = 14
    SENSOR = 15
    COMM = 16
    ESTIMATOR = 17
    OVERRUN = 18
    STATE = 19
    DETECTOR = 20
    COMMON_MODE = 21
    AGE = 22
    TEMPERATURE_AGE = 23
    COUNTED = 24
    """And one more for each of `COUNTED`."""
    DEADLINE_MISSES = 24
    REJECTED = 25
    LOST_FRAMES = 26
    BUS_LOAD = 27
    LATENCY = 28
    LATENESS = 29
    CONFIG_HASH = 30


COUNTED: Final = (*Counted._fields, "config_hash")

OF_A_DRIVE: Final = {
    "Estimate": {
        "Health": Source.HEALTH,
        "Speed": Source.SPEED,
        "LoadTorque": Source.LOAD,
        "LossProbability": Source.LOST,
        "Nis": Source.NIS,
    },
    "Thermal": {
        "FaultClass": Source.FAULT_CLASS,
        "Tmixed": Source.MIXED,
        "Maisd": Source.MAISD,
        "FaultSensor": Source.FAULT_SENSOR,
        "Jumps": Source.JUMPS,
        "DegradationRate": Source.RATE,
    },
}

OF_THE_SET: Final = {
    "Gateway_Adhesion": (
        {
            "Reason": Source.ADHESION_REASON,
            "Detector": Source.DETECTOR,
            "CommonMode": Source.COMMON_MODE,
            "Age": Source.AGE,
        },
        {"Adhesion": Source.ADHESION},
    ),
    "Gateway_Faults": (
        {
            "Reason": Source.FAULTS_REASON,
            "SensorFault": Source.SENSOR,
            "CommFault": Source.COMM,
            "EstimatorFault": Source.ESTIMATOR,
            "Overrun": Source.OVERRUN,
            "Age": Source.TEMPERATURE_AGE,
        },
        {"Thermal": Source.THERMAL},
    ),
    "Gateway_Info": (
        {
            "ConfigHash": Source.CONFIG_HASH,
            "LatencyP99": Source.LATENCY,
            "LatenessP99": Source.LATENESS,
        },
        {},
    ),
    "Gateway_Status": (
        {
            "State": Source.STATE,
            "DeadlineMisses": Source.DEADLINE_MISSES,
            "RejectedFrames": Source.REJECTED,
            "LostFrames": Source.LOST_FRAMES,
            "BusLoad": Source.BUS_LOAD,
        },
        {},
    ),
}
"""Signals of the whole set, and those that there are for every drive, its number behind."""

Ints = NDArray[np.int64]


class Sheet(NamedTuple):
    """Constants of M messages in the order of their ids, S columns.

    codec: address of the messages' `struct codec`; given (M, S): which signals carry a value, the
    others keep their start value; source, drive (M, S): where a signal's value comes from
    (`Source`), and of which drive; cycle_ns (M,); changing: number of the message that is sent at a
    change as well; slack_ns: what is due within this is due now; tick_ns: period of the loop.
    """

    codec: int
    given: NDArray[np.uint8]
    source: Ints
    drive: Ints
    cycle_ns: Ints
    changing: int
    slack_ns: int
    tick_ns: int


class Memory(NamedTuple):
    """next_ns, counter (M,): when each is due, how many have gone; key (N + 4,): of the last tick.

    key: the drives' thermal flags, then the set's `sensor`, `comm`, `estimator`, `overrun`.
    """

    next_ns: Ints
    counter: Ints
    key: Ints


class Room(NamedTuple):
    """For one tick: values (M, S), payload (M, 64) of the frames in a row, message (M,) of each."""

    value: NDArray[np.float64]
    payload: NDArray[np.uint8]
    message: Ints
