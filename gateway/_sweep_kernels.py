"""A tick of the bank in one call: samples made even, chords, filters, innovations, judgement.

Each step is a loop of its own with a twin of its own (`estimators`, `_bank_kernels`); here they are
put one behind the other, because a call from Python costs more than most of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from estimators._adapt_kernels import absorb
from estimators._lanes_kernels import ekf_lanes, ukf_lanes
from estimators._lock_kernels import lock_sweep
from estimators._unbalance_kernels import balance
from gateway._bank_kernels import drop_over_holes, follow

if TYPE_CHECKING:
    from gateway.pairing import Samples
    from gateway.tracks import Believed, Constants, Room

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_W_E = 2  # pmsm


@inlined
def _before(samples: Samples, believed: Believed, constants: Constants, room: Room) -> None:
    """Samples made even, fed to the chords; this tick's R."""
    rated, dt = constants.rated_a, constants.dt_s
    chords, filters = believed.chords, believed.filters
    balance(
        believed.sensors, samples.drive, samples.y, samples.steps, samples.gap, dt, chords.w,
        chords.ready, rated, room.y,
    )  # fmt: skip
    lock_sweep(
        constants.table, chords, constants.tuning, samples.drive, samples.u, room.y, samples.steps,
        samples.gap, dt,
    )  # fmt: skip
    for k in range(rated.shape[0]):
        for i in range(2):
            room.R[k, i] = constants.noise.R[k, i] * filters.scale[k]


@inlined
def _after(samples: Samples, believed: Believed, constants: Constants, room: Room) -> None:
    """What the innovations say."""
    filters = believed.filters
    for k in range(room.w_e.shape[0]):
        room.w_e[k] = filters.x[k, _W_E]
    absorb(
        samples.drive, room.nis, samples.steps, constants.dt_s, constants.smoothing,
        constants.limits.settle_steps, constants.table, constants.rated_a, room.w_e,
        believed.chords, filters.active, filters.steps, filters.nis, filters.scale, filters.lean,
    )  # fmt: skip


@inlined
def _judge(
    samples: Samples, now: int, causes: Ints, fresh: Flags, believed: Believed,
    constants: Constants, room: Room,
) -> bool:  # fmt: skip
    return follow(  # type: ignore[no-any-return,unused-ignore]
        samples.drive, room.ok, now, causes, fresh, believed.chords, believed.filters,
        believed.tracks, constants.limits, believed.told,
    )  # fmt: skip


@inlined
def _over_holes(samples: Samples, believed: Believed, constants: Constants, room: Room) -> None:
    """Whose filter cannot bridge what is missing begins anew. A tick without samples is fine."""
    drop_over_holes(
        samples.drive, samples.steps, samples.gap, constants.coast_steps, believed.filters,
        believed.tracks,
    )  # fmt: skip
    for k in range(room.ok.shape[0]):
        room.ok[k] = True


@lean
def advance_ekf(
    samples: Samples, now: int, causes: Ints, fresh: Flags, believed: Believed,
    constants: Constants, room: Room,
) -> bool:  # fmt: skip
    """One tick of N drives, M samples; fills `believed.told`. True where a filter has to begin.

    causes, fresh (N,): as for `_bank_kernels.follow`; room: y, nis for at least M samples.
    """
    _over_holes(samples, believed, constants, room)
    if samples.drive.shape[0]:
        _before(samples, believed, constants, room)
        filters = believed.filters
        ekf_lanes(
            constants.table, constants.noise.Q, room.R, constants.noise.coast, filters.x,
            filters.P, samples.drive, samples.u, room.y, samples.steps, samples.gap,
            constants.dt_s, room.nis, room.ok, filters.lean, room.lanes,
        )  # fmt: skip
        _after(samples, believed, constants, room)
    return _judge(samples, now, causes, fresh, believed, constants, room)


@lean
def advance_ukf(
    samples: Samples, now: int, causes: Ints, fresh: Flags, believed: Believed,
    constants: Constants, room: Room,
) -> bool:  # fmt: skip
    """The same with the UKF."""
    _over_holes(samples, believed, constants, room)
    if samples.drive.shape[0]:
        _before(samples, believed, constants, room)
        filters = believed.filters
        ukf_lanes(
            constants.table, constants.noise.Q, room.R, constants.noise.coast, filters.x,
            filters.P, samples.drive, samples.u, room.y, samples.steps, samples.gap,
            constants.dt_s, constants.kappa, room.nis, room.ok, filters.lean, room.lanes,
        )  # fmt: skip
        _after(samples, believed, constants, room)
    return _judge(samples, now, causes, fresh, believed, constants, room)
