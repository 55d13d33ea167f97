"""Which inputs of every drive are valid in a tick: records. The C sources have the rules.

What makes an input invalid is in `gateway/core/inputs.c`, the fields of the records in
`gateway/core/records.h`. May know: channels and their numbers. May not know: frames, clocks,
estimators.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import Nanos
from dbc.records import DRIVE_CHANNELS, INPUT_STATUS, Records
from gateway.core.codes import Flag, Reason
from gateway.core.receiving import Receiver

NONE: Final = -1
"""In place of a channel that does not exist."""


class Places(NamedTuple):
    """`drive_channels` of N drives, (N,); motion, status: fields of it."""

    channels: Records
    motion: NDArray[np.int32]
    status: NDArray[np.int32]


def places(
    rows: Sequence[tuple[int, int, Sequence[int], int, int]],
    limit_ns: Sequence[Nanos],
    sum_limit_a: Sequence[float],
) -> Places:
    """`Places` from rows of first channel, end, electrical channels, Motion, Status of each drive.

    limit_ns: how old a sample of current may be; sum_limit_a: limit of the sum of the phases, A.
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


class InputMonitor:
    """`input_status` of N drives, as `status`; a tick fills it."""

    def __init__(self, receiver: Receiver, channels: Records) -> None:
        """channels: `drive_channels`."""
        self.receiver, self.channels = receiver, channels
        self.status = statuses(len(channels))
