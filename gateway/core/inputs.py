"""Which inputs of every drive are valid in a tick: its records. The rules are in C.

What makes an input invalid stands in `gateway/core/inputs.c`, the fields of the records in
`gateway/core/records.h`. May know: channels and their numbers. May not know: frames, clocks,
estimators.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc.frame import Nanos
from dbc.records import DRIVE_CHANNELS, INPUT_STATUS, Addressed, Records, pointer
from gateway.core.codes import Flag, Reason
from gateway.core.receiving import Receiver

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]

NONE: Final = -1
"""No such channel."""


class Places(NamedTuple):
    """`drive_channels` of N drives, (N,); motion, status: fields of it."""

    channels: Records
    motion: NDArray[np.int32]
    status: NDArray[np.int32]


class Inputs(NamedTuple):
    """Fields of `input_status` of N drives, (N,), by short names.

    cause: `reason`; fresh: `sample_fresh`; commanded: `command_valid`; speed: `speed_rad_s`;
    suspect: `current_sum_fault`; comm.
    """

    cause: Bytes
    fresh: Flags
    commanded: Flags
    speed: Array
    suspect: Flags
    comm: Bytes


def places(
    rows: Sequence[tuple[int, int, Sequence[int], int, int]],
    limit_ns: Sequence[Nanos],
    sum_limit_a: Sequence[float],
) -> Places:
    """From every drive's first channel and that behind its last, electrical ones, Motion, Status.

    limit_ns: how old a sample of current may be; sum_limit_a: what the phases' sum may be, A.
    """
    made = np.zeros(len(rows), DRIVE_CHANNELS)
    for one, (first, end, electrical, motion, status) in zip(made, rows, strict=True):
        one["first"], one["end"], one["motion"], one["status"] = first, end, motion, status
        one["electrical"] = [*electrical, NONE, NONE][:2]
    made["max_age_ns"], made["max_current_sum_a"] = limit_ns, sum_limit_a
    return Places(made, made["motion"], made["status"])


def statuses(n: int) -> Records:
    """`input_status` of N drives of which nothing is known."""
    made = np.zeros(n, INPUT_STATUS)
    made["speed_rad_s"], made["reason"], made["comm"] = np.nan, Reason.STARTING, Flag.UNKNOWN
    return made


def columns(status: Records) -> Inputs:
    """Fields of these records."""
    return Inputs(
        status["reason"], status["sample_fresh"].view(np.bool_),
        status["command_valid"].view(np.bool_), status["speed_rad_s"],
        status["current_sum_fault"].view(np.bool_), status["comm"],
    )  # fmt: skip


def inputs(n: int) -> Inputs:
    """Of N drives of which nothing is known."""
    return columns(statuses(n))


class InputMonitor(Addressed):
    """`input_status` of N drives, as `status`; `assess` once per tick fills it."""

    columns: Inputs
    _channels: Any
    _status: Any

    def __init__(self, receiver: Receiver, channels: Records) -> None:
        """channels: `drive_channels`."""
        self.receiver, self.channels = receiver, channels
        self.status = statuses(len(channels))
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        self.columns = columns(self.status)
        self._channels = pointer("struct drive_channels", self.channels)
        self._status = pointer("struct input_status", self.status)

    def assess(self, intruder: bool, now: Nanos) -> None:
        """`assess_inputs`, once the frames of a tick are in; `heartbeat_lost` is the caller's."""
        lib.assess_inputs(self.receiver.pointer, self._channels, intruder, now, self._status)
