"""Messages that are sent every tick, as arrays for the compiled encoder.

`dbc.codec.Codec.encode` and `dbc.e2e.protect` say the same for one message, and are what
tests compare this with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc._tables import tables
from dbc.codec import PAYLOAD, Codec
from dbc.spec import MessageSpec, SignalSpec

Ints = NDArray[np.int64]

SINGLE, DOUBLE = 32, 64
WIDEST: Final = 53
"""Bits of a signal whose every value is one number of 64-bit floating point."""


class Form(NamedTuple):
    """Constants: of a message (M, ..), then of a signal (T, ..), those of a message together.

    first, signals: its first row and how many; given (M, S): which columns carry a value, the
    others keep their start value; base (M, 64): payload with every signal at its start value.
    place (T, 5): first byte, number of bytes, shift, whether the first byte is the highest, bits of
    a float; factors (T, 2): scale and offset; limits (T, 2): lowest and highest raw value; bits
    (T, 5): mask, "none", start value, lowest, highest.
    """

    first: Ints
    signals: Ints
    given: NDArray[np.bool_]
    base: NDArray[np.uint8]
    place: Ints
    factors: NDArray[np.float64]
    limits: NDArray[np.float64]
    bits: NDArray[np.uint64]


def form(codec: Codec, given: Mapping[str, Sequence[str]]) -> Form:
    """Tables of the messages named, numbered in this order, and the signals that get a value.

    Raises ValueError for a message with a multiplexed signal or a whole number of more than 53
    bits: those go through `Codec.encode`; KeyError for a name that there is not.
    """
    specs = [codec.by_name[name] for name in given]
    odd = [spec.name for spec in specs if not _plain(spec)]
    if odd:
        msg = f"not for the compiled encoder: {', '.join(odd)}"
        raise ValueError(msg)
    width = max((len(spec.signals) for spec in specs), default=0)
    columns = np.zeros((len(specs), width), dtype=np.bool_)
    base = np.zeros((len(specs), PAYLOAD), dtype=np.uint8)
    for m, spec in enumerate(specs):
        for name in given[spec.name]:
            columns[m, spec.column(name)] = True
        base[m, : spec.length] = list(codec.encode(spec, {}))
    signals = [signal for spec in specs for signal in spec.signals]
    rows = tables(specs)
    bits = [
        [
            raw & (1 << s.length) - 1
            for raw in (
                -1, s.start_raw if s.not_available is None else s.not_available, s.start_raw,
                s.raw_min, s.raw_max,
            )
        ]
        for s in signals
    ]  # fmt: skip
    return Form(
        rows.rows[:, 0].copy(), rows.rows[:, 1].copy(), columns, base, rows.layout[:, :5].copy(),
        np.array([(s.scale, s.offset) for s in signals], dtype=np.float64).reshape(-1, 2),
        np.array([_limits(s) for s in signals], dtype=np.float64).reshape(-1, 2),
        np.array(bits, dtype=np.uint64).reshape(-1, 5),
    )  # fmt: skip


def _limits(signal: SignalSpec) -> tuple[float, float]:
    """Lowest and highest raw value."""
    if not signal.is_float:
        return signal.raw_min, signal.raw_max
    low, high = sorted(
        (limit - signal.offset) / signal.scale for limit in (signal.float_min, signal.float_max)
    )
    largest = float(np.finfo(np.float32 if signal.length == SINGLE else np.float64).max)
    return max(low, -largest), min(high, largest)


def _plain(spec: MessageSpec) -> bool:
    return not any(
        s.mux_parent or (not s.is_float and s.length > WIDEST) or _bytes_apart(s)
        for s in spec.signals
    )


def _bytes_apart(signal: SignalSpec) -> bool:
    """A double off the byte grid: nine bytes."""
    return signal.length == DOUBLE and signal.start % 8 != (7 if signal.is_big_endian else 0)
