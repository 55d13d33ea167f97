"""E2E of the compiled core for the receive and the send loop: rows of arrays to addresses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined
from dbc.records import E2E_CONFIG, E2E_STATE, Records

Bytes = NDArray[np.uint8]

_CONFIG, _STATE = E2E_CONFIG.itemsize, E2E_STATE.itemsize
_check, _sm_check, _protect = symbol("e2e_check"), symbol("e2e_sm_check"), symbol("e2e_protect")


@inlined
def e2e_check(data: Bytes, row: int, c: int, config: Records, state: Records) -> int:
    """`e2e_check` in dbc/e2e.c: a frame of channel c, its bytes in a row of data (n, 64)."""
    return _check(  # type: ignore[no-any-return]
        config.ctypes.data + c * _CONFIG, state.ctypes.data + c * _STATE,
        data.ctypes.data + row * data.strides[0],
    )  # fmt: skip


@inlined
def e2e_sm_check(c: int, status: int, state: Records) -> int:
    """`e2e_sm_check`: one receiver cycle of channel c."""
    return _sm_check(state.ctypes.data + c * _STATE, status)  # type: ignore[no-any-return]


@inlined
def e2e_protect(payload: Bytes, row: int, m: int, counter: int, config: Records) -> None:
    """`e2e_protect`: header of message m, its bytes in a row of payload (n, 64)."""
    _protect(
        config.ctypes.data + m * _CONFIG, payload.ctypes.data + row * payload.strides[0], counter
    )
