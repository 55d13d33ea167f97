"""What the bank keeps of its drives, as arrays: filters, memories, limits, what is told.

May know: numbers. May not know: frames, clocks, flags.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators._lanes import LanesRoom, lanes_room
from estimators.lock import LockState, LockTuning
from estimators.models.pmsm import Noise
from estimators.unbalance import Unbalance
from gateway.health import Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Filters(NamedTuple):
    """x (N, 5) and P (N, 5, 5) of every drive, and what belongs to them, (N,).

    active: there is a filter; steps: sub-steps since its start, negative once it has become a
    number that is none; nis: smoothed; scale: variance of the currents over the configured one,
    as the innovations show it; lean: voltage along q that the motor lacks against its data, V.
    """

    x: Array
    P: Array
    active: Flags
    steps: Ints
    nis: Array
    scale: Array
    lean: Array


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
    """When what is believed: see the constants of `bank` and `lock`, whose names these are."""

    R_s: Array
    psi_f: Array
    pole_pairs: Array
    moving_nm: Array
    chords: int
    tolerances: tuple[float, float, float, float]
    settle_steps: int
    disagree_ticks: int
    diverged_ns: int
    loose: float
    forget: float
    flux_near: float
    flux_sure: float
    resistance_sure: float


class Told(NamedTuple):
    """What every drive is found to be in a tick, (N,); NaN where a number is not known.

    health, and the reason where it is not tracking: numbers of `gateway.health`.
    """

    health: Ints
    reason: Ints
    agrees: Ints
    begins: Flags
    speed: Array
    load: Array
    sigma: Array
    nis: Array


class Believed(NamedTuple):
    """All that the bank remembers of N drives, and what it tells of them."""

    filters: Filters
    tracks: Tracks
    chords: LockState
    sensors: Unbalance
    told: Told


class Constants(NamedTuple):
    """What does not change: motors and noise (`pmsm`), when what is believed.

    rated_a: (N,) A; dt_s: sub-step; coast_steps: sub-steps that any filter bridges; smoothing: of
    the NIS; kappa: of the UKF.
    """

    table: Array
    noise: Noise
    rated_a: Array
    tuning: LockTuning
    limits: Limits
    dt_s: float
    coast_steps: int
    smoothing: float
    kappa: float


class Room(NamedTuple):
    """For one tick: y (M, 2) made even, nis (M,), R (N, 2), w_e (N,), ok (N,); for filters."""

    y: Array
    nis: Array
    R: Array
    w_e: Array
    ok: Flags
    lanes: LanesRoom


def room(n: int, samples: int) -> Room:
    """For N drives and so many samples."""
    return Room(
        np.zeros((samples, 2)), np.zeros(samples), np.zeros((n, 2)), np.zeros(n),
        np.ones(n, dtype=np.bool_), lanes_room(n),
    )  # fmt: skip


def filters(n: int) -> Filters:
    """N drives without a filter."""
    return Filters(
        x=np.zeros((n, 5)),
        P=np.tile(np.eye(5), (n, 1, 1)),
        active=np.zeros(n, dtype=np.bool_),
        steps=np.zeros(n, dtype=np.int64),
        nis=np.full(n, 2.0),
        scale=np.ones(n),
        lean=np.zeros(n),
    )


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


def told(n: int) -> Told:
    """Room for N drives."""
    speed, load, sigma, nis = np.full((4, n), np.nan)
    health, reason, agrees = np.zeros((3, n), dtype=np.int64)
    reason[:] = Reason.STARTING
    return Told(health, reason, agrees, np.zeros(n, dtype=np.bool_), speed, load, sigma, nis)
