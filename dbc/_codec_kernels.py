"""Decoding and encoding of the compiled core for loops that are still numba's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined

Bytes = NDArray[np.uint8]

_decode, _encode = symbol("decode_frames"), symbol("encode_frame")


@inlined
def decode_frames(
    codec: int, frames: int, message: NDArray[np.int32], payload: Bytes,
    value: NDArray[np.float64], validity: Bytes,
) -> None:  # fmt: skip
    """`decode_frames` in dbc/decode.c: the first `frames` rows. codec: `CodecTables.address`."""
    _decode(
        codec, frames, message.ctypes.data, payload.ctypes.data, value.ctypes.data,
        validity.ctypes.data,
    )  # fmt: skip


@inlined
def encode_frame(
    codec: int, m: int, value: NDArray[np.float64], given: Bytes, payload: Bytes, row: int
) -> None:
    """`encode_frame` in dbc/encode.c: message m, from a row of value (n, S) and given[m]."""
    _encode(
        codec, m, value.ctypes.data + row * value.strides[0],
        given.ctypes.data + m * given.strides[0], payload.ctypes.data + row * payload.strides[0],
    )  # fmt: skip
