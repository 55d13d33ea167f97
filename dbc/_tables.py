"""A message set as the tables that the compiled decoder reads; `_kernels` explains the columns."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc._kernels import CHOSEN, IS_CODED, SATURATING, SPECIAL, SWAPPED, signed
from dbc.spec import MessageSpec, SignalSpec


class Tables(NamedTuple):
    """One row per signal, but `rows`: one per message."""

    rows: NDArray[np.int64]
    layout: NDArray[np.int64]
    keys: NDArray[np.uint64]
    factors: NDArray[np.float64]
    ranges: NDArray[np.int64]
    there: NDArray[np.uint64]


MOST_KEYS: Final = (1 << 64) - 1
MOST_SELECTOR_BITS: Final = 8
"""Of a selector whose every value has its entry in `there`."""
MOST_SIGNALS: Final = 64
"""An entry's bits."""


def _kind(s: SignalSpec, is_signed: bool) -> int:
    """`KIND` of `dbc._kernels`."""
    return (
        IS_CODED * (s.not_available is not None)
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


def _keys(s: SignalSpec, is_signed: bool) -> tuple[int, ...]:
    """A row of `keys`."""
    mask = (1 << s.length) - 1
    sign = 1 << (s.length - 1) if is_signed else 0
    coded = s.not_available is not None
    low, high, code = ((raw & mask) ^ sign for raw in (s.raw_min, s.raw_max, s.not_available or 0))
    first, end = low + s.saturates, high + 1 - s.saturates
    if coded and first <= code < end:
        end = code
    # One too few of all keys of 64 bits, whose number has none.
    return mask, sign, low, high, code, first & mask, min(max(end - first, 0), MOST_KEYS)


def _there(spec: MessageSpec) -> tuple[str, list[int]] | None:
    """Its selector, and by every raw value of that which signals are there, a bit for each.

    None where there is none, or more than one, or too much of it to be listed.
    """
    selectors = {s.mux_parent for s in spec.signals} - {None}
    if len(selectors) != 1 or len(spec.signals) > MOST_SIGNALS:
        return None
    (chosen,) = (s for s in spec.signals if s.name in selectors)
    if chosen.length > MOST_SELECTOR_BITS or chosen.is_float:
        return None
    listed = []
    for bits in range(1 << chosen.length):
        raw = signed(bits, chosen.length) if chosen.is_signed else bits
        mine = (
            not s.mux_parent or any(low <= raw <= high for low, high in s.mux_ranges)
            for s in spec.signals
        )
        listed.append(sum(found << k for k, found in enumerate(mine)))
    return chosen.name, listed


def tables(messages: Sequence[MessageSpec]) -> Tables:
    """Of all signals of these messages."""
    rows: list[tuple[int, ...]] = []
    layout: list[tuple[int, ...]] = []
    keys: list[tuple[int, ...]] = []
    factors: list[tuple[float, ...]] = []
    ranges: list[tuple[int, int]] = []
    there: list[int] = []
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
                s.start >> 3, count, shift, s.is_big_endian, s.length if s.is_float else 0, parent,
                first_range, _word(s), _kind(s, is_signed),
            ))  # fmt: skip
            keys.append(_keys(s, is_signed))
            factors.append((s.scale, s.offset, s.float_min, s.float_max))
        whole = all(not row[-1] & SPECIAL and row[-2] >= 0 for row in layout[first:])
        fixed = not any(row[-1] & CHOSEN for row in layout[first:])
        chosen = _there(spec) if whole else None
        selector = first + places[chosen[0]] if chosen else -1
        rows.append(
            (first, len(spec.signals), whole and (fixed or selector >= 0), selector, len(there))
        )
        there += chosen[1] if chosen else []
    return Tables(
        np.array(rows, np.int64).reshape(-1, 5),
        np.array(layout, np.int64).reshape(-1, 9),
        np.array(keys, np.uint64).reshape(-1, 7),
        np.array(factors, np.float64).reshape(-1, 4),
        np.array(ranges, np.int64).reshape(-1, 2),
        np.array(there, np.uint64),
    )
