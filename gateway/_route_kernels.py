"""Compiled search for whose an identifier is, and what frames cost on the wire. Own twins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean

if TYPE_CHECKING:
    from gateway.receiving import Routes

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_EXTENDED, _FD = 1, 8  # dbc.frame
_NO_ROUTE, _OWN = -1, -2  # receiving


@inlined
def route(can_id: int, flags: int, routes: Routes) -> int:
    """Channel of an identifier; below 0 as in `receiving`, -1 for any other."""
    if not flags & _EXTENDED and can_id < routes.standard.shape[0]:
        return int(routes.standard[can_id])
    key = np.int64(can_id) | (np.int64(flags & _EXTENDED) << 31)
    first, last = 0, routes.key.shape[0]
    while first < last:
        middle = (first + last) // 2
        if routes.key[middle] < key:
            first = middle + 1
        else:
            last = middle
    if first < routes.key.shape[0] and routes.key[first] == key:
        return int(routes.channel[first])
    return _NO_ROUTE


@lean
def busy_s(
    busy: float,
    can_id: NDArray[np.uint32],
    flags: Bytes,
    length: Bytes,
    routes: Routes,
    classic_s: Array,
    fd_s: Array,
) -> float:
    """`busy` and the seconds that a tick's frames took on the wire, the gateway's own left out."""
    for r in range(can_id.shape[0]):
        if route(can_id[r], flags[r], routes) != _OWN:
            busy += fd_s[length[r]] if flags[r] & _FD else classic_s[length[r]]
    return busy
