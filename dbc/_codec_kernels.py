"""Encoding by the compiled core, for the loop of the outbox, which is still numba's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined

Bytes = NDArray[np.uint8]

_encode = symbol("encode_frame")


@inlined
def encode_frame(
    codec: int, m: int, value: NDArray[np.float64], given: Bytes, payload: Bytes, row: int
) -> None:
    """`encode_frame` in dbc/encode.c: message m, from a row of value (n, S) and given[m]."""
    _encode(
        codec, m, value.ctypes.data + row * value.strides[0],
        given.ctypes.data + m * given.strides[0], payload.ctypes.data + row * payload.strides[0],
    )  # fmt: skip
