"""A message set as the tables that `dbc/decode.c` and `dbc/encode.c` read: `struct codec`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from _traction_core import ffi, lib

from dbc.records import MESSAGE, MUX_RANGE, SIGNAL
from dbc.spec import MessageSpec, SignalSpec

PAYLOAD: Final[int] = lib.PAYLOAD_BYTES
"""Width of a row of payload bytes, whatever the length of the message."""
_WORD, _LAST_WORD = 8, PAYLOAD - 8


class CodecTables:
    """Constant tables of a message set: records of its `messages`, `signals` and `mux_ranges`.

    width: columns of a decoded row. pointer: the `struct codec`, for cffi; address: the same as a
    number, for compiled loops. Both are valid as long as this object exists; a deep copy returns
    the object itself.
    """

    def __init__(self, specs: Sequence[MessageSpec]) -> None:
        """Build the tables; messages are numbered in the order of `specs`.

        Raises ValueError for a signal that ends behind `PAYLOAD` bytes.
        """
        self.width = max((len(spec.signals) for spec in specs), default=0)
        self.messages = np.zeros(len(specs), MESSAGE)
        rows: list[tuple[Any, ...]] = []
        ranges: list[tuple[int, int]] = []
        present: list[int] = []
        first_rows: dict[int, int] = {}
        for message, spec in zip(self.messages, specs, strict=True):
            places = {signal.name: k for k, signal in enumerate(spec.signals)}
            message["first_signal"], message["signal_count"] = len(rows), len(places)
            first = first_rows.setdefault(id(spec.signals), len(rows))
            if first < len(rows):  # an earlier message has the same signals
                rows += rows[first : first + len(places)]
            else:
                for signal in spec.signals:
                    rows.append(_row(signal, spec, places, len(ranges)))
                    ranges += signal.mux_ranges
            selector = _listed_by(spec)
            if selector is not None:
                message["is_listed"], message["selector"] = 1, places[selector.name]
                message["first_present"] = len(present)
                present += _present(spec, selector)
        self.signals = np.array(rows, SIGNAL)
        for message in self.messages:
            first = message["first_signal"]
            depths = self.signals["mux_depth"][first : first + message["signal_count"]]
            message["mux_depth"] = depths.max(initial=0)
        self.mux_ranges = np.array(ranges, MUX_RANGE)
        self.present = np.array(present, np.uint64)
        self.pointer: Any = ffi.new("struct codec *", {
            "messages": ffi.from_buffer("struct message[]", self.messages),
            "signals": ffi.from_buffer("struct signal[]", self.signals),
            "mux_ranges": ffi.from_buffer("struct mux_range[]", self.mux_ranges),
            "present": ffi.from_buffer("uint64_t[]", self.present),
            "message_count": len(specs), "width": self.width,
        })  # fmt: skip
        self.address = int(ffi.cast("intptr_t", self.pointer))

    def __deepcopy__(self, _memo: dict[int, object]) -> CodecTables:
        """Return this object: the tables are constant."""
        return self


def _row(
    signal: SignalSpec, spec: MessageSpec, places: Mapping[str, int], first_range: int
) -> tuple[Any, ...]:
    """The record of a signal, in the order of the fields of `SIGNAL`."""
    depth, selector = 0, signal.mux_parent
    while selector:
        depth, selector = depth + 1, spec.signals[places[selector]].mux_parent
    fields = {
        **_place(signal), **_meaning(signal), "mux_depth": depth,
        "multiplexer": places[signal.mux_parent] if signal.mux_parent else 0,
        "first_range": first_range, "range_count": len(signal.mux_ranges),
    }  # fmt: skip
    return tuple(fields[name] for name in SIGNAL.names)


def _listed_by(spec: MessageSpec) -> SignalSpec | None:
    """The one selector of a listed message (`struct message`); None for any other."""
    selectors = {signal.mux_parent for signal in spec.signals} - {None}
    if len(selectors) != 1 or len(spec.signals) > 64:
        return None
    selector = next(signal for signal in spec.signals if signal.name in selectors)
    return None if selector.length > lib.MAX_LISTED_BITS else selector


def _present(spec: MessageSpec, selector: SignalSpec) -> Iterator[int]:
    """Yield for each selector value a mask: bit k is set if signal k is in such a frame."""
    for bits in range(1 << selector.length):
        negative = selector.is_signed and bits >> (selector.length - 1)
        raw = bits - (1 << selector.length) if negative else bits
        selected = (
            not signal.mux_parent or any(low <= raw <= high for low, high in signal.mux_ranges)
            for signal in spec.signals
        )
        yield sum(found << k for k, found in enumerate(selected))


def _place(signal: SignalSpec) -> dict[str, int]:
    """Fields of the record for the position of the signal's bits."""
    first = min(signal.start >> 3, _LAST_WORD)
    # Number of bits before the signal, in its own byte order, from the first of the eight bytes on.
    before = signal.start - 8 * first
    if signal.is_big_endian:
        before = 8 * (before >> 3) + 7 - (before & 7)
    behind = before + signal.length
    if 8 * first + behind > 8 * PAYLOAD:
        msg = f"{signal.name}: ends behind {PAYLOAD} bytes"
        raise ValueError(msg)
    return {
        "first_byte": first,
        "shift": max(8 * _WORD - behind, 0) if signal.is_big_endian else before,
        "ninth_bits": max(behind - 8 * _WORD, 0),
        "big_endian": signal.is_big_endian,
    }


def _meaning(signal: SignalSpec) -> dict[str, int | float]:
    """Fields of the record for the meaning of the signal's bits."""
    mask = (1 << signal.length) - 1
    is_signed = signal.is_signed and not signal.is_float
    sign = 1 << (signal.length - 1) if is_signed else 0
    low, high, none = (
        (raw & mask) ^ sign for raw in (signal.raw_min, signal.raw_max, signal.not_available or 0)
    )
    # Fast path for most values, without saturated ends; it stops at a code inside the range.
    first, end = low + signal.saturates, high + 1 - signal.saturates
    if signal.not_available is not None and first <= none < end:
        end = none
    kind = lib.SIGNAL_INTEGER
    if signal.is_float:
        kind = lib.SIGNAL_FLOAT32 if signal.length == 32 else lib.SIGNAL_FLOAT64
    elif signal.length == 64 and not is_signed:
        kind = lib.SIGNAL_UINT64
    return {
        "mask": mask, "sign": sign, "key_min": low, "key_max": high, "key_none": none,
        "valid_first": first & mask, "valid_count": min(max(end - first, 0), mask),
        "start": signal.start_raw & mask, "scale": signal.scale, "offset": signal.offset,
        "float_min": signal.float_min, "float_max": signal.float_max, "type": kind,
        "has_none": signal.not_available is not None, "saturates": signal.saturates,
    }  # fmt: skip
