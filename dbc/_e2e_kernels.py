"""Protection by the compiled core, for the loop of the outbox, which is still numba's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined
from dbc.records import E2E_CONFIG, Records

Bytes = NDArray[np.uint8]

_CONFIG = E2E_CONFIG.itemsize
_protect = symbol("e2e_protect")


@inlined
def e2e_protect(payload: Bytes, row: int, m: int, counter: int, config: Records) -> None:
    """`e2e_protect`: header of message m, its bytes in a row of payload (n, 64)."""
    _protect(
        config.ctypes.data + m * _CONFIG, payload.ctypes.data + row * payload.strides[0], counter
    )
