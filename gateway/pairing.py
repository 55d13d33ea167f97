"""What the inbox remembers to make samples of half messages, as arrays for the compiled loop.

Currents and voltages with the same counter, received within half a counter period, belong
together. The time between two samples is the counter difference times the cycle time; stamps
only decide which turn of the counter it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.channel import Channel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Kind(IntEnum):
    """What a channel carries; the first three become samples."""

    CURRENTS = 0
    VOLTAGES = 1
    BLOCK = 2
    MOTION = 3
    TEMPERATURES = 4
    STATUS = 5


class Row(IntEnum):
    """Verdict on a decoded row."""

    GOOD = 0
    MISSING = 1
    OUTSIDE = 2


class Trouble(IntEnum):
    """Index into `PairState.trouble`."""

    UNPAIRED = 0
    LATE = 1
    ANY = 2
    """Not 0 where there is something to look at, a restart included."""


_KINDS = {
    "PhaseCurrents": Kind.CURRENTS,
    "StatorVoltages": Kind.VOLTAGES,
    "Samples": Kind.BLOCK,
    "Motion": Kind.MOTION,
    "Temperatures": Kind.TEMPERATURES,
    "Status": Kind.STATUS,
}
_MOST_COLUMNS = 33


class Wiring(NamedTuple):
    """Constants, a row per channel.

    message: its number in the codec; columns: (C, 33) columns taken, the first `points` of
    them; quality: column of `Quality` or -1; width: number of signals; steps: sub-steps per sample.
    """

    kind: Ints
    drive: Ints
    message: Ints
    columns: Ints
    points: Ints
    quality: Ints
    width: Ints
    period_ns: Ints
    steps: Ints


class PairState(NamedTuple):
    """Memory, a row per drive.

    half: (N, 2, 16, 2) halves waiting by counter; half_ns: (N, 2, 16) their stamps, -1 none;
    sequence, sample_ns: counter and stamp of the last sample, -1 none; sum_error: smoothed
    |Ia + Ib + Ic|, A; restart: it starts anew this tick; trouble: counts since last looked at.
    """

    half: Array
    half_ns: Ints
    sequence: Ints
    sample_ns: Ints
    sum_error: Array
    restart: Flags
    trouble: Ints


class Samples(NamedTuple):
    """M samples in the row layout of the filters, SI units, stationary frame.

    drive (M,); u (M, 2) mean voltage, y (M, 2) current at the end; steps (M,) sub-steps of 125 us
    since the sample before; gap (M,) sub-steps missing before that.
    """

    drive: NDArray[np.int32]
    u: Array
    y: Array
    steps: Ints
    gap: Ints

    def first(self, count: int) -> Samples:
        """The first `count` rows, as views."""
        return Samples(
            self.drive[:count], self.u[:count], self.y[:count], self.steps[:count], self.gap[:count]
        )


def wiring(channels: Sequence[Channel]) -> Wiring:
    """Constants of the channels, numbered in this order."""
    n = len(channels)
    columns = np.zeros((n, _MOST_COLUMNS), dtype=np.int64)
    for k, channel in enumerate(channels):
        columns[k, : len(channel.picked)] = channel.picked

    def each(values: list[int]) -> Ints:
        return np.array(values, dtype=np.int64).reshape(n)

    return Wiring(
        each([_KINDS[c.kind] for c in channels]),
        each([c.drive for c in channels]),
        each([c.index for c in channels]),
        columns,
        each([len(c.picked) for c in channels]),
        each([c.quality for c in channels]),
        each([len(c.spec.signals) for c in channels]),
        each([c.period_ns for c in channels]),
        each([c.steps for c in channels]),
    )


def start(drives: int) -> PairState:
    """Nothing received yet."""
    return PairState(
        half=np.zeros((drives, 2, 16, 2)),
        half_ns=np.full((drives, 2, 16), -1, dtype=np.int64),
        sequence=np.zeros(drives, dtype=np.int64),
        sample_ns=np.full(drives, -1, dtype=np.int64),
        sum_error=np.zeros(drives),
        restart=np.zeros(drives, dtype=np.bool_),
        trouble=np.zeros(len(Trouble), dtype=np.int64),
    )


def room(rows: int) -> Samples:
    """Space for the samples of `rows` frames, eight each."""
    m = 8 * rows
    return Samples(
        np.zeros(m, dtype=np.int32),
        np.zeros((m, 2)),
        np.zeros((m, 2)),
        np.zeros(m, dtype=np.int64),
        np.zeros(m, dtype=np.int64),
    )
