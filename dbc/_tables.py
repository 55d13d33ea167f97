"""A message set as the tables that the compiled decoder reads; `_kernels` explains the columns."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc._kernels import CHOSEN, IS_CODED, IS_SIGNED, SATURATING, SPECIAL, SWAPPED
from dbc.spec import MessageSpec, SignalSpec


class Tables(NamedTuple):
    """One row per signal, but `rows`: one per message."""

    rows: NDArray[np.int64]
    layout: NDArray[np.int64]
    keys: NDArray[np.uint64]
    factors: NDArray[np.float64]
    ranges: NDArray[np.int64]


_U64: Final = (1 << 64) - 1
_TOP: Final = 1 << 63


def _kind(s: SignalSpec, is_signed: bool) -> int:
    """`KIND` of `dbc._kernels`."""
    return (
        IS_SIGNED * is_signed
        | IS_CODED * (s.not_available is not None)
        | SATURATING * s.saturates
        | SWAPPED * s.is_big_endian
        | CHOSEN * bool(s.mux_parent)
        | SPECIAL * (s.is_float or (s.length == 64 and not is_signed))
    )


def _word(s: SignalSpec) -> int:
    """`WORD` of `dbc._kernels`: -1 where the signal lies within no word."""
    inside = s.start & 63
    if s.is_big_endian:
        # From the word's first bit as it is sent; a signal's start is its highest bit.
        inside = 8 * (inside >> 3) + 7 - (inside & 7)
    if inside + s.length > 64 or sys.byteorder != "little":
        return -1
    shift = 64 - inside - s.length if s.is_big_endian else inside
    return (s.start >> 6 << 6) + shift


def tables(messages: Sequence[MessageSpec]) -> Tables:
    """Of all signals of these messages."""
    rows: list[tuple[int, int, bool]] = []
    layout: list[tuple[int, ...]] = []
    keys: list[tuple[int, ...]] = []
    factors: list[tuple[float, ...]] = []
    ranges: list[tuple[int, int]] = []
    for spec in messages:
        first = len(layout)
        places = {s.name: k for k, s in enumerate(spec.signals)}
        for s in spec.signals:
            if s.is_big_endian:
                lead = 7 - (s.start & 7)
                count = (lead + s.length + 7) >> 3
                shift = 8 * count - lead - s.length
            else:
                shift = s.start & 7
                count = (shift + s.length + 7) >> 3
            parent = places[s.mux_parent] if s.mux_parent else -1
            first_range = (len(ranges) << 16) | len(s.mux_ranges)
            ranges += s.mux_ranges
            is_signed = s.is_signed and not s.is_float
            layout.append((
                s.start >> 3, count, shift, s.is_big_endian, s.length, is_signed,
                s.length if s.is_float else 0, s.not_available is not None, parent, first_range,
                s.saturates, _word(s), _kind(s, is_signed),
            ))  # fmt: skip
            flip = _TOP if is_signed else 0
            code = 0 if s.not_available is None else s.not_available
            bounds = ((raw & _U64) ^ flip for raw in (s.raw_min, s.raw_max, code))
            keys.append(((1 << s.length) - 1, flip, *bounds))
            factors.append((s.scale, s.offset, s.float_min, s.float_max))
        plain = all(not row[-1] & (CHOSEN | SPECIAL) and row[-2] >= 0 for row in layout[first:])
        rows.append((first, len(spec.signals), plain))
    return Tables(
        np.array(rows, np.int64).reshape(-1, 3),
        np.array(layout, np.int64).reshape(-1, 13),
        np.array(keys, np.uint64).reshape(-1, 5),
        np.array(factors, np.float64).reshape(-1, 4),
        np.array(ranges, np.int64).reshape(-1, 2),
    )
