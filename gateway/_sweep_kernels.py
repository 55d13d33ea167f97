"""A tick of the bank in one call: samples made even, chords, filters, innovations, judgement.

Each step is a loop of its own, in C or in `_bank_kernels`; here they are put one behind the other,
because a call from Python costs more than most of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean
from estimators._lanes_kernels import ekf_lanes, ukf_lanes
from gateway._bank_kernels import drop_over_holes, follow

if TYPE_CHECKING:
    from gateway.pairing import Samples
    from gateway.tracks import Believed, Constants, Room

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_calibrate = symbol("calibrate_currents")
_acquire = symbol("acquisition_add")
_adapt = symbol("adapt_filters")


@inlined
def _before(samples: Samples, believed: Believed, constants: Constants, room: Room) -> None:
    """Samples made even, fed to the chords; this tick's R."""
    m, dt, mine = samples.drive.shape[0], constants.dt_s, room.samples
    for k in range(m):
        mine.drive[k], mine.steps[k], mine.gap[k] = (
            samples.drive[k],
            samples.steps[k],
            samples.gap[k],
        )
        mine.u[k] = complex(samples.u[k, 0], samples.u[k, 1])
        mine.i[k] = complex(samples.y[k, 0], samples.y[k, 1])
    chords, filters = believed.chords, believed.filters
    _calibrate(
        mine.ctypes.data, m, believed.sensors.ctypes.data, chords.ctypes.data,
        constants.rated_a.ctypes.data, dt,
    )  # fmt: skip
    _acquire(
        mine.ctypes.data, m, constants.table.ctypes.data, chords.ctypes.data,
        constants.acquisition.ctypes.data, dt,
    )  # fmt: skip
    for k in range(m):
        room.y[k, 0], room.y[k, 1] = mine.i[k].real, mine.i[k].imag
    for k in range(room.R.shape[0]):
        for i in range(2):
            room.R[k, i] = constants.noise.R[k, i] * filters.r_scale[k]


@inlined
def _after(samples: Samples, believed: Believed, constants: Constants, room: Room) -> None:
    """What the innovations say."""
    m, mine = samples.drive.shape[0], room.samples
    for k in range(m):
        mine.nis[k] = room.nis[k]
    _adapt(
        mine.ctypes.data, m, believed.filters.ctypes.data, believed.chords.ctypes.data,
        constants.table.ctypes.data, constants.rated_a.ctypes.data, constants.dt_s,
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
            constants.dt_s, room.nis, room.ok, filters.v_q_bias, room.lanes,
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
            constants.dt_s, constants.kappa, room.nis, room.ok, filters.v_q_bias, room.lanes,
        )  # fmt: skip
        _after(samples, believed, constants, room)
    return _judge(samples, now, causes, fresh, believed, constants, room)
