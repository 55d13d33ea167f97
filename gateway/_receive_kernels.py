"""Receiving by the compiled core, for the loop over ticks that is still numba's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_receive = symbol("receive_frames")
_bus_tick, _bus_receive = symbol("bus_load_tick"), symbol("bus_load_receive")
_find_lost = symbol("find_lost_nodes")


@inlined
def receive_frames(
    receiver: int, first: int, last: int, t_ns: NDArray[np.int64], can_id: NDArray[np.uint32],
    flags: Bytes, length: Bytes, data: Bytes, now: int,
) -> bool:  # fmt: skip
    """`receive_frames` in gateway/core/receive.c: rows first .. last - 1 of a block's columns."""
    return bool(_receive(
        receiver, last - first, t_ns.ctypes.data + 8 * first, can_id.ctypes.data + 4 * first,
        flags.ctypes.data + first, length.ctypes.data + first,
        data.ctypes.data + data.strides[0] * first, now,
    ))  # fmt: skip


@inlined
def bus_load_receive(
    load: int, receiver: int, first: int, last: int, can_id: NDArray[np.uint32], flags: Bytes,
    length: Bytes, now: int,
) -> None:  # fmt: skip
    """`bus_load_tick` and `bus_load_receive` in gateway/core/busload.c: rows first .. last - 1."""
    _bus_tick(load, now)
    _bus_receive(
        load, receiver, last - first, can_id.ctypes.data + 4 * first, flags.ctypes.data + first,
        length.ctypes.data + first,
    )  # fmt: skip


@inlined
def find_lost_nodes(supervision: int, now: int, lost: NDArray[np.bool_]) -> None:
    """`find_lost_nodes` in gateway/core/supervision.c: fills lost (N,)."""
    _find_lost(supervision, now, lost.ctypes.data)
