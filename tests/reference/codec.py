"""Decoding and encoding in plain Python, on one whole integer per frame: no table, no NumPy.

Independent of `dbc/decode.c` and `dbc/encode.c`, which tests compare with this and with cantools.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.spec import MessageSpec, Reading, SignalSpec, Validity

_FORMATS = {32: (">f", ">I"), 64: (">d", ">Q")}
_LARGEST = {n: float(np.finfo(t).max) for n, t in ((32, np.float32), (64, np.float64))}


def extract(data: bytes, signal: SignalSpec) -> int:
    """Unsigned bits of a signal. Bits beyond the data read 0."""
    mask = (1 << signal.length) - 1
    if not signal.is_big_endian:
        return (int.from_bytes(data, "little") >> signal.start) & mask
    shift = 8 * len(data) - _first(signal) - signal.length
    whole = int.from_bytes(data, "big")
    return (whole >> shift if shift >= 0 else whole << -shift) & mask


def _first(signal: SignalSpec) -> int:
    """Bits in front of a big-endian signal."""
    return 8 * (signal.start >> 3) + 7 - (signal.start & 7)


def whole(signal: SignalSpec, bits: int) -> int:
    """Two's complement of a signed integer's bits."""
    if not signal.is_signed or signal.is_float:
        return bits
    return bits - (1 << signal.length) if bits >> (signal.length - 1) else bits


def present(spec: MessageSpec, signal: SignalSpec, raws: Mapping[str, int]) -> bool:
    """Whether every selector up the chain of a signal has a value of its range."""
    while signal.mux_parent:
        selector = raws[signal.mux_parent]
        if not any(low <= selector <= high for low, high in signal.mux_ranges):
            return False
        signal = next(s for s in spec.signals if s.name == signal.mux_parent)
    return True


def judge(signal: SignalSpec, raw: float) -> Validity:
    """Validity of a raw value that is present in the frame."""
    if signal.is_float:
        value = raw * signal.scale + signal.offset
        inside = signal.float_min <= value <= signal.float_max
        return Validity.VALID if inside else Validity.RANGE
    if raw == signal.not_available:
        return Validity.NOT_AVAILABLE
    if not signal.raw_min <= raw <= signal.raw_max:
        return Validity.RANGE
    if signal.saturates and raw in (signal.raw_min, signal.raw_max):
        return Validity.SATURATED
    return Validity.VALID


def decode(spec: MessageSpec, data: bytes) -> dict[str, Reading]:
    """All signals of one frame by name; the raw value of an absent float is not looked at."""
    raws = {s.name: whole(s, extract(data, s)) for s in spec.signals}
    readings = {}
    for s in spec.signals:
        raw: int | float = raws[s.name]
        if s.is_float:
            unpack, pack = _FORMATS[s.length]
            raw = struct.unpack(unpack, struct.pack(pack, raw))[0]
        if not present(spec, s, raws):
            readings[s.name] = Reading(raw, math.nan, Validity.ABSENT)
        else:
            value, validity = float(raw) * s.scale + s.offset, judge(s, raw)
            if validity is Validity.RANGE and not math.isfinite(value):
                validity = Validity.NOT_A_NUMBER
            readings[s.name] = Reading(raw, value, validity)
    return readings


def decode_rows(
    codec: Codec, index: Sequence[int], payload: NDArray[np.uint8]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """As `Codec.decode_rows`."""
    value = np.full((len(index), codec.width), np.nan)
    validity = np.full((len(index), codec.width), Validity.ABSENT, np.uint8)
    for i, number in enumerate(index):
        if 0 <= number < len(codec.messages):
            spec = codec.messages[number]
            readings = decode(spec, payload[i].tobytes()[: spec.length])
            for k, reading in enumerate(readings.values()):
                value[i, k], validity[i, k] = reading.value, reading.validity
    return value, validity


def encode(spec: MessageSpec, values: Mapping[str, float | None]) -> bytearray:
    """Payload from physical values; signals not named have their start value."""
    bits = {
        s.name: _bits(s, values[s.name])
        if s.name in values
        else s.start_raw & ((1 << s.length) - 1)
        for s in spec.signals
    }
    raws = {s.name: whole(s, bits[s.name]) for s in spec.signals}
    little = big = 0
    for s in spec.signals:
        if not present(spec, s, raws):
            continue
        if s.is_big_endian:
            big |= bits[s.name] << (8 * spec.length - _first(s) - s.length)
        else:
            little |= bits[s.name] << s.start
    size = spec.length
    pairs = zip(little.to_bytes(size, "little"), big.to_bytes(size, "big"), strict=True)
    return bytearray(one | other for one, other in pairs)


def _bits(signal: SignalSpec, value: float | None) -> int:
    """Raw bits of a physical value, saturated at the range."""
    mask = (1 << signal.length) - 1
    if value is None or not math.isfinite(value):
        none = signal.start_raw if signal.not_available is None else signal.not_available
        return none & mask
    raw = (value - signal.offset) / signal.scale
    if signal.is_float:
        return _float_bits(signal, raw)
    # Compared before rounding: a large enough number divided by the scale is infinite.
    if raw <= signal.raw_min:
        return signal.raw_min & mask
    return (signal.raw_max if raw >= signal.raw_max else round(raw)) & mask


def _float_bits(signal: SignalSpec, raw: float) -> int:
    low, high = sorted(
        (limit - signal.offset) / signal.scale for limit in (signal.float_min, signal.float_max)
    )
    largest = _LARGEST[signal.length]
    bounded = min(max(raw, low, -largest), high, largest)
    unpack, pack = _FORMATS[signal.length]
    bits: int = struct.unpack(pack, struct.pack(unpack, bounded))[0]
    return bits
