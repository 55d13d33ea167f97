"""A block of rows into payloads of one message: `Codec.encode`, many at a time.

For the messages sent a thousand times a second. The tests hold it to `Codec.encode` byte by byte.

May know: bits. May not know: what the numbers mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.spec import MessageSpec


class Packer:
    """Packs columns `names` of one message; the other signals have their start value."""

    def __init__(self, codec: Codec, spec: MessageSpec, names: Sequence[str]) -> None:
        """Raises KeyError for a name the message does not have."""
        signals = [spec.signals[spec.column(name)] for name in names]
        self._codec, self._spec, self._names = codec, spec, tuple(names)
        # A user's own DBC may have them; the codec itself then packs, row by row.
        self._plain = any(s.is_big_endian or s.is_float for s in spec.signals)
        self._length = spec.length
        self._scale = np.array([s.scale for s in signals])
        self._offset = np.array([s.offset for s in signals])
        self._low = np.array([s.raw_min for s in signals], dtype=np.float64)
        self._high = np.array([s.raw_max for s in signals], dtype=np.float64)
        self._none = np.array(
            [s.start_raw if s.not_available is None else s.not_available for s in signals],
            dtype=np.int64,
        )
        self._mask = np.array([(1 << s.length) - 1 for s in signals], dtype=np.int64)
        self._shifts = [s.start for s in signals]
        base = int.from_bytes(codec.encode(spec, {}), "little")
        for shift, mask in zip(self._shifts, self._mask.tolist(), strict=True):
            base &= ~(mask << shift)
        self._base = base

    def pack(self, values: NDArray[np.float64]) -> list[bytearray]:
        """(n, S) physical values -> n payloads, header bytes at their start value.

        Non-finite numbers become the not-available code, numbers out of range the end value.
        """
        if self._plain:
            rows = (dict(zip(self._names, row, strict=True)) for row in values.tolist())
            return [self._codec.encode(self._spec, row) for row in rows]
        known = np.isfinite(values)
        raw = np.rint((np.where(known, values, 0.0) - self._offset) / self._scale)
        whole = np.clip(raw, self._low, self._high).astype(np.int64)
        bits = np.where(known, whole, self._none) & self._mask
        out = []
        shifts, length = self._shifts, self._length
        for row in bits.tolist():
            word = self._base
            for shift, field in zip(shifts, row, strict=True):
                word |= field << shift
            out.append(bytearray(word.to_bytes(length, "little")))
        return out
