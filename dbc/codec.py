"""Bits to numbers and back, for one frame or a block of frames, by the DBC alone.

`bind` compares a DBC with the contract and builds the tables; after that nothing here looks at
cantools, and cantools is what the tests compare with.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.binding import load, specs_of
from dbc.contract import Contract
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from dbc.spec import (
    ABSENT,
    EXTENDED_KEY,
    NOT_AVAILABLE,
    RANGE,
    SATURATED,
    VALID,
    DbcMismatch,
    Match,
    MessageSpec,
    Reading,
    SignalSpec,
    Validity,
)
from dbc.text import read_bytes

PAYLOAD: Final = 64
"""Width of a row of payload bytes, whatever the message's length."""

_FLOAT_FORMATS: Final = {32: (">f", ">I"), 64: (">d", ">Q")}
_FLOAT_LARGEST: Final = {n: float(np.finfo(t).max) for n, t in ((32, np.float32), (64, np.float64))}


class _Writer(NamedTuple):
    """What `encode` needs of one signal, worked out once."""

    signal: SignalSpec
    shift: int
    mask: int
    absent: int
    """Raw bits for "no value": the not-available code, else the start value."""
    start: int
    scale: float
    offset: float
    low: int
    high: int
    is_float: bool
    is_big_endian: bool


class Codec:
    """A bound DBC: specs by name and id, decoding and encoding. Immutable after construction."""

    def __init__(self, path: Path, messages: Iterable[MessageSpec], digest: str = "") -> None:
        """`messages` are checked and numbered from 0 (by `bind`). Compiles the kernel.

        digest: SHA-256 of the file, hexadecimal.
        """
        from dbc import _kernels
        from dbc._tables import tables

        self.path = path
        self.digest = digest
        self.messages: tuple[MessageSpec, ...] = tuple(messages)
        self.by_name: Mapping[str, MessageSpec] = {m.name: m for m in self.messages}
        self.by_id: Mapping[int, MessageSpec] = {m.key: m for m in self.messages}
        self.fd = any(m.is_fd for m in self.messages)
        self.width = max((len(m.signals) for m in self.messages), default=0)
        self._kernels = _kernels
        self.tables = tables(self.messages)
        self._writers = [_writers(m) for m in self.messages]
        self._bases = [_bases(writers) for writers in self._writers]
        self._multiplexed = [any(s.mux_parent for s in m.signals) for m in self.messages]
        # Compiled (or loaded from numba's cache) now, not in the first tick.
        self.decode_rows(np.zeros(1, np.int32), np.zeros((1, PAYLOAD), np.uint8))

    def match(self, frame: Frame) -> tuple[Match, MessageSpec | None]:
        """Whether a frame may be decoded, and as what. Never raises.

        Remote and error frames are never data; length and format must be the DBC's exactly.
        The spec is given with WRONG_LENGTH and WRONG_FORMAT too: the message is then corrupt.
        """
        flags = frame.flags
        if flags & ERROR:
            return Match.ERROR_FRAME, None
        if flags & REMOTE:
            return Match.REMOTE, None
        spec = self.by_id.get(frame.can_id | (EXTENDED_KEY if flags & EXTENDED else 0))
        if spec is None:
            return Match.UNKNOWN_ID, None
        if bool(flags & FD) != spec.is_fd:
            return Match.WRONG_FORMAT, spec
        if len(frame.data) != spec.length:
            return Match.WRONG_LENGTH, spec
        return Match.OK, spec

    def decode(self, spec: MessageSpec, data: bytes) -> dict[str, Reading]:
        """All signals of one frame by name; ABSENT ones have value NaN.

        Raises ValueError for data of another length: `match` first.
        """
        if len(data) != spec.length:
            msg = f"{spec.name}: {len(data)} bytes, expected {spec.length}"
            raise ValueError(msg)
        signals = spec.signals
        raws = self._raws(spec, data)
        places = {s.name: k for k, s in enumerate(signals)}
        parents = [places[s.mux_parent] if s.mux_parent else -1 for s in signals]
        hits = [s.mux_ranges for s in signals]
        readings = {}
        for k, signal in enumerate(signals):
            if not self._kernels.chain(k, parents, hits, raws):
                readings[signal.name] = Reading(raws[k], math.nan, Validity.ABSENT)
                continue
            raw: int | float = raws[k]
            if signal.is_float:
                unpack, pack = _FLOAT_FORMATS[signal.length]
                raw = struct.unpack(unpack, struct.pack(pack, raws[k]))[0]
            value = float(raw) * signal.scale + signal.offset
            readings[signal.name] = Reading(raw, value, signal.judge(raw))
        return readings

    def _raws(self, spec: MessageSpec, data: bytes) -> list[int]:
        """Raw integers in order of the signals (bit patterns for floats)."""
        raws = []
        for s in spec.signals:
            bits = self._kernels.extract(data, s.start, s.length, s.is_big_endian)
            keep = not s.is_signed or s.is_float
            raws.append(bits if keep else self._kernels.signed(bits, s.length))
        return raws

    def decode_rows(
        self, index: NDArray[np.int32], payload: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Decode n frames at once: index (n,) `MessageSpec.index`, payload (n, 64) zero-padded.

        Returns physical value (n, S) and Validity (n, S), S = `width`; columns as
        `spec.signals`, the unused ones NaN and ABSENT. Values of other than VALID cells are
        still the scaled number (as cantools gives it) and must not be used. The lengths are
        the caller's to check (`match`).
        """
        n = len(index)
        payload = np.ascontiguousarray(payload)
        value = np.empty((n, self.width))
        validity = np.empty((n, self.width), np.uint8)
        t = self.tables
        self._kernels.decode_block(
            index, payload, t.rows, t.layout, t.keys, t.factors, t.ranges, t.there, value, validity
        )
        return value, validity

    def decode_rows_plain(
        self, index: NDArray[np.int32], payload: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """The twin of `decode_rows` without compiled code, frame by frame."""
        value = np.full((len(index), self.width), np.nan)
        validity = np.full((len(index), self.width), ABSENT, np.uint8)
        for i, number in enumerate(index.tolist()):
            if not 0 <= number < len(self.messages):
                continue
            spec = self.messages[number]
            readings = self.decode(spec, payload[i].tobytes()[: spec.length])
            for k, reading in enumerate(readings.values()):
                value[i, k] = reading.value
                validity[i, k] = reading.validity
        return value, validity

    def encode(self, spec: MessageSpec, values: Mapping[str, float | int | None]) -> bytearray:
        """Payload from physical values, header bytes (Crc, Counter) left at their start value.

        None and non-finite numbers become the not-available code (the start value where there
        is none); numbers out of range become the end value; signals not named have their start
        value. Of multiplexed signals only those are written that the selectors call for.
        Raises KeyError for a name the message does not have.
        """
        writers = self._writers[spec.index]
        little, big = self._bases[spec.index]
        selected = self._selected(spec, values) if self._multiplexed[spec.index] else None
        if selected is not None:
            little = big = 0
        for name, value in values.items():
            writer = writers[name]
            if selected is not None and name in selected:
                continue
            bits = _bits(writer, value)
            if writer.is_big_endian:
                big ^= (bits ^ writer.start) << writer.shift
            else:
                little ^= (bits ^ writer.start) << writer.shift
        for name, bits in (selected or {}).items():
            writer = writers[name]
            if writer.is_big_endian:
                big |= bits << writer.shift
            else:
                little |= bits << writer.shift
        payload = bytearray(little.to_bytes(spec.length, "little"))
        if big:
            for k, byte in enumerate(big.to_bytes(spec.length, "big")):
                payload[k] |= byte
        return payload

    def _selected(
        self, spec: MessageSpec, values: Mapping[str, float | int | None]
    ) -> dict[str, int]:
        """Bits of the signals present under the selectors' own values."""
        writers = self._writers[spec.index]
        names = [s.name for s in spec.signals]
        bits = [
            _bits(writers[name], values[name]) if name in values else writers[name].start
            for name in names
        ]
        raws = [
            self._kernels.signed(b, s.length) if s.is_signed and not s.is_float else b
            for s, b in zip(spec.signals, bits, strict=True)
        ]
        parents = [names.index(s.mux_parent) if s.mux_parent else -1 for s in spec.signals]
        hits = [s.mux_ranges for s in spec.signals]
        return {
            name: bits[k]
            for k, name in enumerate(names)
            if self._kernels.chain(k, parents, hits, raws)
        }


def bind(path: Path, nodes: Sequence[int], contract: Contract | None = None) -> Codec:
    """Load a DBC, compare it with the contract for these drives, build the codec.

    Without a contract it is the FD one if the drives have `Samples`, else the classic one;
    `dbc.contract.ANY` takes any DBC that is sound in itself. Raises DbcMismatch, once, listing
    everything that is wrong.
    """
    path = Path(path)
    before = _digest(path)
    specs = specs_of(path, nodes, contract)
    if _digest(path) != before:
        raise DbcMismatch(path, ["changed while it was read; start again"])
    return Codec(path, specs, before)


def _digest(path: Path) -> str:
    """SHA-256 of a file; empty where it cannot be read, which `specs_of` explains."""
    try:
        return hashlib.sha256(read_bytes(path)).hexdigest()
    except (OSError, ValueError):
        return ""


def _bits(writer: _Writer, value: float | None) -> int:
    """Raw bits of a physical value, saturated at the range."""
    if value is None or value - value != 0:
        return writer.absent
    raw = (value - writer.offset) / writer.scale
    if writer.is_float:
        return _float_bits(writer.signal, raw)
    # Compared before rounding: a large enough number divided by the scale is infinite.
    if raw <= writer.low:
        return writer.low & writer.mask
    if raw >= writer.high:
        return writer.high & writer.mask
    return round(raw) & writer.mask


def _float_bits(signal: SignalSpec, raw: float) -> int:
    """The same for a signal that is a float on the wire."""
    low, high = sorted(
        (limit - signal.offset) / signal.scale for limit in (signal.float_min, signal.float_max)
    )
    largest = _FLOAT_LARGEST[signal.length]
    bounded = min(max(raw, low, -largest), high, largest)
    unpack, pack = _FLOAT_FORMATS[signal.length]
    bits: int = struct.unpack(pack, struct.pack(unpack, bounded))[0]
    return bits


def _writers(spec: MessageSpec) -> dict[str, _Writer]:
    writers = {}
    for s in spec.signals:
        mask = (1 << s.length) - 1
        shift = s.start
        if s.is_big_endian:
            shift = 8 * spec.length - (8 * (s.start >> 3) + 7 - (s.start & 7)) - s.length
        absent = s.start_raw if s.not_available is None else s.not_available
        writers[s.name] = _Writer(
            s, shift, mask, absent & mask, s.start_raw & mask,
            s.scale, s.offset, s.raw_min, s.raw_max, s.is_float, s.is_big_endian,
        )  # fmt: skip
    return writers


def _bases(writers: Mapping[str, _Writer]) -> tuple[int, int]:
    """(little, big) endian integers with every signal at its start value."""
    little = big = 0
    for writer in writers.values():
        if writer.is_big_endian:
            big |= writer.start << writer.shift
        else:
            little |= writer.start << writer.shift
    return little, big


__all__ = [
    "ABSENT",
    "NOT_AVAILABLE",
    "RANGE",
    "SATURATED",
    "VALID",
    "Codec",
    "DbcMismatch",
    "Match",
    "MessageSpec",
    "Reading",
    "SignalSpec",
    "Validity",
    "bind",
    "load",
]
