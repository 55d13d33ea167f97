"""Decode and encode one frame or a block of frames, by the DBC alone.

`bind` compares a DBC with the contract and builds the tables. After that nothing here uses
cantools; the tests compare the results with those of cantools.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.codec_tables import PAYLOAD, CodecTables
from dbc.contract import Contract
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from dbc.load import specs_of
from dbc.spec import (
    EXTENDED_KEY,
    NOT_A_NUMBER,
    RANGE,
    DbcMismatch,
    Match,
    MessageSpec,
    Reading,
    SignalSpec,
    Validity,
)
from dbc.text import printable, read_bytes


class Codec:
    """A bound DBC: specs by name and id, decoding and encoding. Immutable after construction."""

    def __init__(
        self,
        path: Path,
        messages: Iterable[MessageSpec],
        digest: str = "",
        left_out: Sequence[str] = (),
    ) -> None:
        """Build the tables; `messages` must be checked and numbered from 0, as by `bind`.

        digest: SHA-256 of the file, hexadecimal; left_out: entries of the file that are not used.
        """
        self.path = path
        self.left_out = tuple(left_out)
        self.digest = digest
        self.messages: tuple[MessageSpec, ...] = tuple(messages)
        self.by_name: Mapping[str, MessageSpec] = {m.name: m for m in self.messages}
        self.by_id: Mapping[int, MessageSpec] = {m.key: m for m in self.messages}
        self.fd = any(m.is_fd for m in self.messages)
        self.tables = CodecTables(self.messages)
        self.width = self.tables.width
        self._has_floats = any(s.is_float for m in self.messages for s in m.signals)
        self._columns = [{s.name: k for k, s in enumerate(m.signals)} for m in self.messages]

    def own(self, *, creep: bool) -> list[MessageSpec]:
        """Messages that a gateway sends, with `creep` the optional ones too."""
        return [m for m in self.messages if m.is_gateway and (creep or not m.is_optional)]

    def match(self, frame: Frame) -> tuple[Match, MessageSpec | None]:
        """Whether a frame may be decoded, and by which spec. Never raises.

        Remote and error frames are never decoded; length and format must be exactly the DBC's.
        WRONG_LENGTH and WRONG_FORMAT also come with the spec, because that message is corrupt.
        """
        flags = frame.flags
        if flags & ERROR:
            return Match.ERROR_FRAME, None
        if flags & REMOTE:
            return Match.REMOTE, None
        spec = self.by_id.get(frame.can_id | (EXTENDED_KEY if flags & EXTENDED else 0))
        if spec is None:
            return Match.UNKNOWN_ID, None
        if not spec.has_format(bool(flags & FD)):
            return Match.WRONG_FORMAT, spec
        if len(frame.data) != spec.length:
            return Match.WRONG_LENGTH, spec
        return Match.OK, spec

    def decode(self, spec: MessageSpec, data: bytes) -> dict[str, Reading]:
        """Decode all signals of one frame, by name; the value of an ABSENT one is NaN.

        Raises ValueError if the data do not have the spec's length; call `match` first.
        """
        if len(data) != spec.length:
            msg = f"{spec.name}: {len(data)} bytes, expected {spec.length}"
            raise ValueError(msg)
        data = bytes(data).ljust(PAYLOAD, b"\0")
        value, validity = ffi.new("double[]", self.width), ffi.new("uint8_t[]", self.width)
        raw = ffi.new("uint64_t[]", self.width)
        number = ffi.new("int32_t *", spec.index)
        lib.decode_frames(self.tables.pointer, 1, number, data, value, validity)
        lib.raw_values(self.tables.pointer, spec.index, data, raw)
        return {
            s.name: Reading(_raw(s, raw, k), value[k], _validity(validity[k], value[k]))
            for k, s in enumerate(spec.signals)
        }

    def decode_rows(
        self, index: NDArray[np.int32], payload: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Decode n frames at once: index (n,) `MessageSpec.index`, payload (n, 64) zero-padded.

        Returns physical value (n, S) and Validity (n, S), S = `width`. Columns are those of
        `spec.signals`; unused ones are NaN and ABSENT. The value of any other cell that is not
        VALID is still the scaled number, as in cantools, and must not be used. The caller has to
        check the lengths (`match`).
        """
        n = len(index)
        index = np.ascontiguousarray(index, np.int32)
        payload = np.ascontiguousarray(payload)
        value = np.empty((n, self.width))
        validity = np.empty((n, self.width), np.uint8)
        lib.decode_frames(
            self.tables.pointer, n, ffi.from_buffer("int32_t[]", index),
            ffi.from_buffer("uint8_t[]", payload), ffi.from_buffer("double[]", value),
            ffi.from_buffer("uint8_t[]", validity),
        )  # fmt: skip
        if self._has_floats:
            validity[(validity == RANGE) & ~np.isfinite(value)] = NOT_A_NUMBER
        return value, validity

    def encode(self, spec: MessageSpec, values: Mapping[str, float | int | None]) -> bytearray:
        """Payload from physical values, header bytes (Crc, Counter) left at their start value.

        None and non-finite numbers become the not-available code, or the start value if there is
        no such code. Numbers out of range become the end value. Signals not named have their start
        value. Of the multiplexed signals only those that the selectors select are written.
        Raises KeyError for a name that the message does not have.
        """
        columns = self._columns[spec.index]
        value, given = ffi.new("double[]", len(columns)), ffi.new("uint8_t[]", len(columns))
        for name, number in values.items():
            k = columns[name]
            value[k], given[k] = math.nan if number is None else number, 1
        payload = bytearray(PAYLOAD)
        data = ffi.from_buffer("uint8_t[]", payload)
        lib.encode_frame(self.tables.pointer, spec.index, value, given, data)
        return bytearray(data[0 : spec.length])

    def encode_rows(
        self, spec: MessageSpec, names: Sequence[str], values: NDArray[np.float64]
    ) -> list[bytearray]:
        """Encode n frames of one message, as `encode`: values (n, S) of the S signals named."""
        columns = [self._columns[spec.index][name] for name in names]
        value = np.zeros((len(values), len(spec.signals)))
        value[:, columns] = values
        given = np.zeros(len(spec.signals), np.uint8)
        given[columns] = 1
        payload = np.empty((len(values), PAYLOAD), np.uint8)
        lib.encode_frames(
            self.tables.pointer, spec.index, *value.shape, ffi.from_buffer("double[]", value),
            ffi.from_buffer("uint8_t[]", given), ffi.from_buffer("uint8_t[]", payload),
        )  # fmt: skip
        return [bytearray(row[: spec.length]) for row in payload]


def _validity(code: int, value: float) -> Validity:
    """Validity of a value; the core's code for a float that is NaN or infinite is RANGE."""
    lost = code == RANGE and not math.isfinite(value)
    return Validity.NOT_A_NUMBER if lost else Validity(code)


def _raw(signal: SignalSpec, raw: Any, k: int) -> int | float:
    """Number k of `raw_values`, in the type of its signal."""
    if signal.is_float:
        return ffi.cast("double *", raw)[k]  # type: ignore[no-any-return]
    return ffi.cast("int64_t *", raw)[k] if signal.is_signed else raw[k]  # type: ignore[no-any-return]


def bind(path: Path, nodes: Sequence[int], contract: Contract | None = None) -> Codec:
    """Load a DBC, compare it with the contract for these drives, build the codec.

    If `contract` is None, it is the FD contract if the drives have `Samples`, else the classic
    one; `dbc.contract.ANY` accepts any DBC that is consistent in itself. Raises one DbcMismatch
    that lists everything that is wrong.
    """
    path = Path(path)
    before = _digest(path)
    specs = specs_of(path, nodes, contract)
    if _digest(path) != before:
        raise DbcMismatch(path, ["changed while it was read; start again"])
    return Codec(path, specs, before)


def bind_usable(path: Path) -> Codec:
    """Codec of the usable part of a foreign DBC; `left_out` lists the rest. Raises DbcMismatch."""
    from dbc.tolerant import read_any_dbc

    specs, left_out = read_any_dbc(Path(path))
    return Codec(Path(path), specs, _digest(Path(path)), [printable(line) for line in left_out])


def _digest(path: Path) -> str:
    """SHA-256 of a file; empty if it cannot be read, because `specs_of` reports that."""
    try:
        return hashlib.sha256(read_bytes(path)).hexdigest()
    except (OSError, ValueError):
        return ""
