"""A tick of the bank in one call: currents calibrated, chords, filters, innovations, judgement.

Each step is a loop of its own, in C or in `_bank_kernels`; here they are put one behind the other,
because a call from Python costs more than most of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean
from gateway._bank_kernels import drop_over_holes, follow

if TYPE_CHECKING:
    from gateway.pairing import Samples
    from gateway.tracks import Believed, Constants, Room

Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]

_calibrate = symbol("calibrate_currents")
_acquire = symbol("acquisition_add")
_filter = symbol("filter_run")
_adapt = symbol("adapt_filters")


@inlined
def _load(samples: Samples, room: Room) -> None:
    """The samples as records."""
    mine = room.samples
    for k in range(samples.drive.shape[0]):
        mine.drive[k], mine.steps[k] = samples.drive[k], samples.steps[k]
        mine.gap[k] = samples.gap[k]
        mine.u[k] = complex(samples.u[k, 0], samples.u[k, 1])
        mine.i[k] = complex(samples.y[k, 0], samples.y[k, 1])


@inlined
def _estimate(m: int, believed: Believed, constants: Constants, room: Room) -> None:
    """M samples through everything that learns from them."""
    samples, dt = room.samples.ctypes.data, constants.dt_s
    motors, rated = constants.table.ctypes.data, constants.rated_a.ctypes.data
    chords, filters = believed.chords.ctypes.data, believed.filters.ctypes.data
    _calibrate(samples, m, believed.sensors.ctypes.data, chords, rated, dt)
    _acquire(samples, m, motors, chords, constants.acquisition.ctypes.data, dt)
    _filter(
        samples, m, motors, constants.noise.ctypes.data, filters, believed.filters.shape[0],
        constants.settings.ctypes.data,
    )  # fmt: skip
    _adapt(samples, m, filters, chords, motors, rated, dt)


@lean
def run_filters(
    samples: Samples, now: int, causes: Bytes, fresh: Flags, believed: Believed,
    constants: Constants, room: Room,
) -> bool:  # fmt: skip
    """One tick of N drives, M samples; fills `believed.told`. True where a filter has to begin.

    causes, fresh (N,): as for `_bank_kernels.follow`; room: for at least M samples.
    """
    # A filter that cannot bridge what is missing begins anew.
    drop_over_holes(
        samples.drive, samples.steps, samples.gap, constants.coast_steps, believed.filters,
        believed.tracks,
    )  # fmt: skip
    _load(samples, room)
    _estimate(samples.drive.shape[0], believed, constants, room)
    return follow(  # type: ignore[no-any-return,unused-ignore]
        samples.drive, now, causes, fresh, believed.chords, believed.filters, believed.tracks,
        constants.limits, believed.told,
    )  # fmt: skip
