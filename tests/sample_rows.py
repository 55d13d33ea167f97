"""Samples and readings of a tick, as `receive.c` fills them, in the words of the references."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


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

    def first(self, count):
        """The first `count` rows, as views."""
        return Samples(
            self.drive[:count], self.u[:count], self.y[:count], self.steps[:count], self.gap[:count]
        )


class Readings(NamedTuple):
    """Measurements of one tick, in order of time, (R,).

    drive, stamp, speed rad/s at the rotor, torque Nm, electrical angle rad, NaN where none is sent.
    """

    drive: Ints
    t_ns: Ints
    speed: Array
    torque: Array
    angle: Array


def workspace(rows):
    """Space for the samples of `rows` frames, eight each."""
    m = 8 * rows
    return Samples(
        np.zeros(m, dtype=np.int32),
        np.zeros((m, 2)),
        np.zeros((m, 2)),
        np.zeros(m, dtype=np.int64),
        np.zeros(m, dtype=np.int64),
    )


def readings(rows):
    """Room for so many."""
    drive, t_ns = (np.zeros(rows, dtype=np.int64) for _ in range(2))
    return Readings(drive, t_ns, np.zeros(rows), np.zeros(rows), np.zeros(rows))


def samples_of(receiver):
    """The receiver's own space for them."""
    return Samples(*(receiver.space[f"sample_{name}"] for name in Samples._fields))


def readings_of(receiver):
    """The receiver's own space for them."""
    return Readings(*(receiver.space[f"motion_{name}"] for name in Readings._fields))
