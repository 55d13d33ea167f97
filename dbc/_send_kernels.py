"""Compiled encoding: numbers to payload bytes, counter and checksum of one frame.

Twin of encoding: `dbc.codec.Codec.encode`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._e2e_kernels import e2e_protect
from dbc._lean import inlined, lean

if TYPE_CHECKING:
    from dbc.records import Records
    from dbc.sending import Form

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_BYTE, _COUNT, _SHIFT, _BIG, _FLOAT = range(5)  # dbc.sending.Form.place
_MASK, _ABSENT, _START, _LOW, _HIGH = range(5)  # dbc.sending.Form.bits
_EIGHT = np.uint64(8)
_SINGLE = 32


@inlined
def _raw(x: float, t: int, form: Form) -> np.uint64:
    """Raw bits of a physical value: saturated at the range, "none" for what is no number."""
    raw = (x - form.factors[t, 1]) / form.factors[t, 0]
    # Compared before rounding: a large enough number divided by the scale is infinite.
    if x - x != 0.0:
        which = _ABSENT
    elif form.place[t, _FLOAT]:
        bounded = min(max(raw, form.limits[t, 0]), form.limits[t, 1])
        if form.place[t, _FLOAT] == _SINGLE:
            return np.uint64(np.float32(bounded).view(np.uint32))
        return np.float64(bounded).view(np.uint64)  # type: ignore[no-any-return,unused-ignore]
    elif raw <= form.limits[t, 0]:
        which = _LOW
    elif raw >= form.limits[t, 1]:
        which = _HIGH
    else:
        return np.uint64(np.int64(np.rint(raw))) & form.bits[t, _MASK]  # type: ignore[no-any-return,unused-ignore]
    return form.bits[t, which]  # type: ignore[no-any-return,unused-ignore]


@inlined
def encode(m: int, value: Array, row: int, form: Form, payload: Bytes) -> None:
    """Payload (row) of message m from value (row, signals); header bytes at their start value."""
    for b in range(payload.shape[1]):
        payload[row, b] = form.base[m, b]
    for k in range(form.signals[m]):
        if not form.given[m, k]:
            continue
        t = form.first[m] + k
        # The base has the start value in its place.
        acc = _raw(value[row, k], t, form) ^ form.bits[t, _START]
        acc <<= np.uint64(form.place[t, _SHIFT])
        at, step = form.place[t, _BYTE], 1
        if form.place[t, _BIG]:
            at, step = at + form.place[t, _COUNT] - 1, -1
        for _ in range(form.place[t, _COUNT]):
            payload[row, at] ^= np.uint8(acc & np.uint64(0xFF))
            acc >>= _EIGHT
            at += step


@lean
def encode_rows(
    message: NDArray[np.int64], value: Array, counter: NDArray[np.int64], form: Form,
    config: Records, payload: Bytes,
) -> None:  # fmt: skip
    """N frames: message (n,) their numbers in form and config, value (n, S), counter (n,).

    Fills payload (n, 64).
    """
    for row in range(message.shape[0]):
        encode(message[row], value, row, form, payload)
        e2e_protect(payload, row, message[row], counter[row] & 0xFF, config)
