"""Input of a thermal method: temperatures of a train's motors, and how the train was driven."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array, Ints

POINTS: Final = ("stator", "drive end", "non-drive end")
CUT_OUT: Final = 1.0 / 400.0
"""A motor with less than this share of the largest mean I^2 is cut out: noise of its sensors."""
MEMORIES_S: Final = (300.0, 3600.0)
"""Time constants of the averages in `features`: a winding's, and a whole motor's."""


class Record(NamedTuple):
    """K samples of M motors, and the L steps of `step_s` in which they were taken.

    temperature: (K, M, 3) degC at `POINTS`, NaN where there is no reading; at: (K,) the step at
    whose end each sample was taken; current_square: (L, M) A^2, mean of the squared current's
    amplitude; speed: (L,) rotor rad/s; ambient: (L,) degC as measured outside.
    """

    temperature: Array
    at: Ints
    current_square: Array
    speed: Array
    ambient: Array
    step_s: float

    @property
    def motors(self) -> int:
        """M."""
        return int(self.temperature.shape[1])


def mean_of_known(values: Array | Sequence[Array], axis: int = 0) -> Array:
    """Mean of the finite values along an axis; NaN where there are none."""
    known = np.isfinite(values)
    count = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def cut_out(record: Record) -> NDArray[np.bool_]:
    """(M,) motors that turned without current for the whole record."""
    square = record.current_square.mean(axis=0)
    return np.asarray(square < CUT_OUT * square.max())


def of_driven_motors(record: Record) -> Record:
    """The record without the readings of motors that were cut out; they get the others' mean I^2.

    Such a motor is heated by its iron and its bearings alone. A model that is fitted to driven
    motors does not explain it, and would be bent by its readings.
    """
    idle = cut_out(record)
    if not idle.any():
        return record
    temperature, square = record.temperature.copy(), record.current_square.copy()
    temperature[:, idle] = np.nan
    square[:, idle] = square[:, ~idle].mean(axis=1, keepdims=True)
    return record._replace(temperature=temperature, current_square=square)


def spacing(record: Record) -> float:
    """Median time between two samples, s."""
    return float(np.median(np.diff(record.at))) * record.step_s


def join(runs: Sequence[Record]) -> Record:
    """Runs of the same train and step, one after another. Raises ValueError for unequal steps."""
    if len({run.step_s for run in runs}) != 1:
        raise ValueError("runs of one step length, at least one, can be joined")
    steps = np.cumsum([0, *(len(run.speed) for run in runs)])
    return Record(
        np.concatenate([run.temperature for run in runs]),
        np.concatenate([run.at + first for run, first in zip(runs, steps.tolist(), strict=False)]),
        np.concatenate([run.current_square for run in runs]),
        np.concatenate([run.speed for run in runs]),
        np.concatenate([run.ambient for run in runs]),
        runs[0].step_s,
    )


def split(record: Record, k: int) -> tuple[Record, Record]:
    """The first k samples (0 < k < K) with their steps, and the rest."""
    step = int(record.at[k - 1]) + 1
    cut = [
        Record(
            record.temperature[samples], record.at[samples] - first, record.current_square[steps],
            record.speed[steps], record.ambient[steps], record.step_s,
        )
        for samples, steps, first in (
            (slice(None, k), slice(None, step), 0), (slice(k, None), slice(step, None), step)
        )
    ]  # fmt: skip
    return cut[0], cut[1]


def features(record: Record) -> Array:
    """(K, U) inputs at every sample: ambient, and fading averages of I^2 and |speed|, SI.

    Every method without a thermal model of its own uses them: one I^2 for the train (the motors'
    mean) and the speed, each with the memories of `MEMORIES_S`.
    """
    square, speed = record.current_square.mean(axis=1), np.abs(record.speed)
    faded = [
        fading(signal, record.step_s / memory)[record.at]
        for memory in MEMORIES_S
        for signal in (square, speed)
    ]
    return np.stack([record.ambient[record.at], *faded], axis=1)


def fading(signal: Array, share: float) -> Array:
    """(L,) first-order average that takes up `share` (<= 1) of new values; starts at the mean."""
    from scipy.signal import lfilter

    share = min(share, 1.0)
    start = np.array([(1.0 - share) * float(signal.mean())])
    out: Array = lfilter([share], [1.0, share - 1.0], signal, zi=start)[0]
    return out
