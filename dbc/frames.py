"""Many frames as arrays, which the compiled loops read. A list of `Frame` holds the same data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi
from numpy.typing import NDArray

from dbc.frame import Frame
from dbc.records import pointer

MAX_DATA_BYTES: Final = 64
"""Bytes kept per frame: the longest data of CAN FD."""


# Resolved once: cffi looks up a type name at each use.
_INT64, _UINT32, _UINT8 = (ffi.typeof(f"{name}[]") for name in ("int64_t", "uint32_t", "uint8_t"))


class Block(NamedTuple):
    """n frames, in the order of reception.

    t_ns (n,) int64; can_id (n,) uint32, flags (n,) uint8 and dlc (n,) int8 as in `Frame`;
    length (n,) uint8; data (n, 64) uint8, zero behind the length; channel (n,) uint16, an index
    into `names`.
    """

    t_ns: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint8]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    dlc: NDArray[np.int8]
    channel: NDArray[np.uint16]
    names: Sequence[str]

    @property
    def size(self) -> int:
        """Number of frames."""
        return len(self.t_ns)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All columns, without the names."""
        return self.t_ns, self.can_id, self.flags, self.length, self.data, self.dlc, self.channel

    def columns(self) -> Any:
        """Addresses of the columns, a `struct frame_columns`. The block has to outlive its use."""
        others = pointer("int8_t", self.dlc), pointer("uint16_t", self.channel)
        return ffi.new("struct frame_columns *", (*self.addresses(), *others))

    def addresses(self) -> tuple[Any, Any, Any, Any, Any]:
        """Addresses of the first five columns, which a tick reads; same condition as `columns`."""
        at = ffi.from_buffer
        return (
            at(_INT64, self.t_ns), at(_UINT32, self.can_id), at(_UINT8, self.flags),
            at(_UINT8, self.length), at(_UINT8, self.data),
        )  # fmt: skip

    def part(self, first: int, last: int) -> Block:
        """Frames first .. last - 1, as views."""
        return self.pick(slice(first, last))

    def pick(self, which: NDArray[np.int64] | NDArray[np.bool_] | slice) -> Block:
        """The frames that an index or a mask selects, copied; for a slice, as views."""
        return Block._make([*(column[which] for column in self.arrays), self.names])

    def frame(self, k: int) -> Frame:
        """Frame number k."""
        return Frame(
            self.t_ns.item(k),
            self.can_id.item(k),
            self.data[k, : self.length.item(k)].tobytes(),
            self.flags.item(k),
            self.names[self.channel.item(k)],
            self.dlc.item(k),
        )

    def frames(self) -> Iterator[Frame]:
        """Yield all frames, in their order."""
        data = self.data.tobytes()
        ends = (
            MAX_DATA_BYTES * np.arange(self.size) + np.minimum(self.length, MAX_DATA_BYTES)
        ).tolist()
        bytes_of = [data[MAX_DATA_BYTES * k : end] for k, end in enumerate(ends)]
        names = [self.names[k] for k in self.channel.tolist()]
        rows = zip(
            self.t_ns.tolist(), self.can_id.tolist(), bytes_of, self.flags.tolist(), names,
            self.dlc.tolist(), strict=True,
        )  # fmt: skip
        return map(partial(tuple.__new__, Frame), rows)

    def ordered(self) -> Block:
        """The frames sorted by time stamp, then id; the sort is stable."""
        t, i = self.t_ns, self.can_id
        later = t[1:] > t[:-1]
        if bool(np.all(later | ((t[1:] == t[:-1]) & (i[1:] >= i[:-1])))):
            return self
        return self.pick(np.lexsort((i, t)))


def blank(rows: int, names: Sequence[str]) -> Block:
    """An unfilled block of `rows` frames of the first channel, with `dlc` -1."""
    return Block(
        np.empty(rows, dtype=np.int64),
        np.empty(rows, dtype=np.uint32),
        np.empty(rows, dtype=np.uint8),
        np.empty(rows, dtype=np.uint8),
        np.empty((rows, MAX_DATA_BYTES), dtype=np.uint8),
        np.full(rows, -1, dtype=np.int8),
        np.zeros(rows, dtype=np.uint16),
        names,
    )


def block_of(frames: Iterable[Frame]) -> Block:
    """Frames as a block, in their order. Data are cut after 64 bytes; `length` counts to 255."""
    rows = list(frames)
    if not rows:
        return EMPTY
    t_ns, can_id, data, flags, channel, dlc = zip(*rows, strict=True)
    names = list(dict.fromkeys(channel))
    number = [0] * len(rows) if len(names) == 1 else [names.index(name) for name in channel]
    # Writable like every other block: a read-only one would need its own compiled code.
    joined = bytearray().join([item.ljust(MAX_DATA_BYTES, b"\0")[:MAX_DATA_BYTES] for item in data])
    return Block(
        np.array(t_ns, dtype=np.int64),
        np.array(can_id, dtype=np.uint32),
        np.array(flags, dtype=np.uint8),
        np.array([min(len(item), 255) for item in data], dtype=np.uint8),
        np.frombuffer(joined, dtype=np.uint8).reshape(-1, MAX_DATA_BYTES),
        np.array(dlc, dtype=np.int8),
        np.array(number, dtype=np.uint16),
        names,
    )


def in_blocks(frames: Iterable[Frame], size: int = 1 << 13) -> Iterator[Block]:
    """Yield frames as blocks of at most `size`; those before an exception come before it."""
    held: list[Frame] = []
    try:
        for frame in frames:
            held.append(frame)
            if len(held) == size:
                yield block_of(held)
                held = []
    except Exception:
        if held:
            yield block_of(held)
        raise
    if held:
        yield block_of(held)


def join(first: Block, second: Block) -> Block:
    """Both blocks as one, `first` before `second`."""
    if not first.size or not second.size:
        return second if not first.size else first
    names = list(dict.fromkeys([*first.names, *second.names]))
    number = np.array([names.index(name) for name in second.names], dtype=np.uint16)
    second = second._replace(channel=number[second.channel])
    pairs = zip(first.arrays, second.arrays, strict=True)
    return Block._make([*map(np.concatenate, pairs), names])


EMPTY: Final = blank(0, [])
