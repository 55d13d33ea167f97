"""What the bank keeps of its drives, as arrays: filters, memories, limits, what is told.

May know: numbers. May not know: frames, clocks, flags.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import DRIVE_ESTIMATE, FILTER_SAMPLE, Columns, Records, zeros
from gateway.health import Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]


class Tracks(NamedTuple):
    """What is remembered of every drive beside its filter, (N,).

    doubts: ticks that the chords have contradicted; diverged_ns: since when it is said to have
    diverged, -1 where it has not; best: standard deviation of the load when it was known best of
    late, Nm; flux: of the magnets over that of the data sheet, NaN where nothing is known (torque
    and load are larger by it); silent: no samples in this tick; load, moved: load after the last
    tick with samples, and how far it had moved in that, Nm.
    """

    doubts: Ints
    diverged_ns: Ints
    best: Array
    flux: Array
    silent: Flags
    load: Array
    moved: Array


class Limits(NamedTuple):
    """When what is believed: see the constants of `bank`, whose names these are."""

    R_s: Array
    psi_f: Array
    pole_pairs: Array
    moving_nm: Array
    pairs: int
    settle_steps: int
    disagree_ticks: int
    diverged_ns: int
    loose: float
    forget: float
    flux_near: float
    flux_sure: float
    resistance_sure: float


class Told(NamedTuple):
    """Fields of `drive_estimate` of N drives, (N,), for loops that are still numba's.

    reason: `health_reason`; speed, load, sigma: `speed_rad_s`, `load_nm`, `load_sigma_nm`. And what
    the chords say of each filter (agrees, `enum consistency`), and which filters begin.
    """

    health: Bytes
    reason: Bytes
    agrees: Ints
    begins: Flags
    speed: Array
    load: Array
    sigma: Array
    nis: Array


class Believed(NamedTuple):
    """All that the bank remembers of N drives, and what it tells of them.

    filters, chords, sensors: `struct filter`, `acquisition` and `current_calibration` of every
    drive.
    """

    filters: Columns
    tracks: Tracks
    chords: Columns
    sensors: Columns
    told: Told


class Constants(NamedTuple):
    """What does not change: motors and noise (`pmsm`), when what is believed.

    rated_a: (N,) A; noise: `struct filter_noise` (N,); acquisition, settings: one
    `struct acquisition_limits` and `filter_settings`; dt_s: sub-step; coast_steps: sub-steps that
    any filter bridges.
    """

    table: Array
    noise: Columns
    rated_a: Array
    acquisition: Columns
    settings: Columns
    limits: Limits
    dt_s: float
    coast_steps: int


class Room(NamedTuple):
    """For one tick: `struct filter_sample` of its samples, (M,)."""

    samples: Columns


def room(samples: int) -> Room:
    """For so many samples."""
    return Room(zeros(samples, FILTER_SAMPLE))


def tracks(n: int) -> Tracks:
    """N drives of which nothing is remembered."""
    return Tracks(
        doubts=np.zeros(n, dtype=np.int64),
        diverged_ns=np.full(n, -1, dtype=np.int64),
        best=np.full(n, np.inf),
        flux=np.full(n, np.nan),
        silent=np.zeros(n, dtype=np.bool_),
        load=np.zeros(n),
        moved=np.zeros(n),
    )


def estimates(n: int) -> Records:
    """`drive_estimate` of N drives of which nothing is known."""
    made = np.zeros(n, DRIVE_ESTIMATE)
    for name in ("speed_rad_s", "load_nm", "load_sigma_nm", "nis", "flux_ratio"):
        made[name] = np.nan
    made["health_reason"] = Reason.STARTING
    return made


def told_of(records: Records) -> Told:
    """Fields of these records."""
    n = len(records)
    return Told(
        records["health"], records["health_reason"], np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.bool_), records["speed_rad_s"], records["load_nm"],
        records["load_sigma_nm"], records["nis"],
    )  # fmt: skip


def told(n: int) -> Told:
    """Of N drives of which nothing is known."""
    return told_of(estimates(n))
