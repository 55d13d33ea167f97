"""Decodes blocks of frames to signals, for files, and counts the frames that a DBC cannot decode.

Protection is not checked: a frame with a wrong checksum or counter is decoded like any other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import ERROR, EXTENDED, FD, REMOTE
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.spec import (
    ABSENT,
    EXTENDED_KEY,
    NOT_AVAILABLE,
    RANGE,
    SATURATED,
    Match,
    MessageSpec,
    SignalSpec,
    Validity,
)

_FLOAT_BITS: Final = 53


class Decoded(NamedTuple):
    """The n frames of a block that a DBC describes, in order, with their signals.

    frames: the n frames; message (n,) int32, their `MessageSpec.index`; value (n, S) as from
    `Codec.decode_rows`, NaN: no value; marked (n, S): out of range or saturated; exact: by (message
    index, place) of a signal whose integers a float cannot hold, (n,) objects: int, or None for no
    value.
    """

    frames: Block
    message: NDArray[np.int32]
    value: NDArray[np.float64]
    marked: NDArray[np.bool_]
    exact: dict[tuple[int, int], NDArray[np.object_]]

    def marks(self, k: int, message: MessageSpec) -> str:
        """Names of the marked signals of frame k, separated by spaces."""
        places = np.flatnonzero(self.marked[k]).tolist()
        return " ".join(message.signals[place].name for place in places)


def is_exact(signal: SignalSpec) -> bool:
    """Whether a signal has integers that need more than a float's 53 bits."""
    plain = (signal.scale, signal.offset) == (1, 0) and not signal.is_float
    return plain and signal.length > _FLOAT_BITS


class Decoder:
    """Decodes blocks; `counts` (Match -> frames) and `cells` (Validity -> values) sum over all."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self.counts: Counter[Match] = Counter()
        self.cells: Counter[Validity] = Counter()
        self.longer = 0
        """Frames with more bytes than their message has."""
        self.outside: Counter[str] = Counter()
        """`Message.Signal` -> values that are marked."""
        self._exact = {
            (m.index, place): signal
            for m in codec.messages
            for place, signal in enumerate(m.signals)
            if is_exact(signal)
        }
        ordered = sorted(codec.messages, key=lambda m: m.key)
        self._keys = np.array([m.key for m in ordered], dtype=np.int64)
        self._index = np.array([m.index for m in ordered], dtype=np.int32)
        formats = [(m.has_format(False), m.has_format(True)) for m in ordered]
        self._formats = np.array(formats, dtype=np.bool_).reshape(-1, 2)
        self._length = np.array([m.length for m in ordered], dtype=np.int64)

    def match(self, block: Block) -> NDArray[np.int32]:
        """`MessageSpec.index` of every frame, -1 if it cannot be decoded; counts every outcome."""
        flags = block.flags
        keys = block.can_id.astype(np.int64) | np.where(flags & EXTENDED, EXTENDED_KEY, 0)
        place = np.searchsorted(self._keys, keys).clip(max=max(len(self._keys) - 1, 0))
        known = (
            self._keys[place] == keys if len(self._keys) else np.zeros(block.size, dtype=np.bool_)
        )
        outcome = np.full(block.size, Match.UNKNOWN_ID, dtype=np.uint8)
        if known.any():
            outcome[known] = Match.OK
            outcome[known & (self._length[place] > block.length)] = Match.WRONG_LENGTH
            has_format = self._formats[place, (flags & FD != 0).astype(np.intp)]
            outcome[known & ~has_format] = Match.WRONG_FORMAT
        outcome[flags & REMOTE != 0] = Match.REMOTE
        outcome[flags & ERROR != 0] = Match.ERROR_FRAME
        for number, count in enumerate(np.bincount(outcome, minlength=len(Match)).tolist()):
            if count:
                self.counts[Match(number)] += count
        good = outcome == Match.OK
        if good.any():
            self.longer += int(np.count_nonzero(self._length[place[good]] < block.length[good]))
        index = np.full(block.size, -1, dtype=np.int32)
        index[good] = self._index[place[good]]
        return index

    def decode(self, block: Block) -> Decoded:
        """Decode the frames of a block that the DBC describes."""
        index = self.match(block)
        good = index >= 0
        frames, index = block.pick(good), index[good]
        value, validity = self.codec.decode_rows(index, frames.data[:, :MAX_DATA_BYTES])
        for number, count in enumerate(np.bincount(validity.ravel()).tolist()):
            if count and number != ABSENT:
                self.cells[Validity(number)] += count
        value[(validity == NOT_AVAILABLE) | (validity == ABSENT) | ~np.isfinite(value)] = np.nan
        marked = (validity == RANGE) | (validity == SATURATED)
        for number in np.unique(index[marked.any(axis=1)]).tolist():
            message = self.codec.messages[number]
            counts = np.count_nonzero(marked[index == number], axis=0).tolist()
            for place, count in enumerate(counts):
                if count:
                    self.outside[f"{message.name}.{message.signals[place].name}"] += count
        exact = {
            key: self._whole(key, frames, index, value) for key in self._exact if key[0] in index
        }
        return Decoded(frames, index, value, marked, exact)

    def _whole(
        self,
        key: tuple[int, int],
        frames: Block,
        index: NDArray[np.int32],
        value: NDArray[np.float64],
    ) -> NDArray[np.object_]:
        """(n,) raw integers of one signal, or None."""
        number, place = key
        message = self.codec.messages[number]
        out = np.full(len(index), None, dtype=object)
        for k in np.flatnonzero((index == number) & ~np.isnan(value[:, place])).tolist():
            data = frames.data[k, : message.length].tobytes()
            out[k] = self.codec.decode(message, data)[message.signals[place].name].raw
        return out


def seen(blocks: Iterable[Block], codec: Codec) -> list[MessageSpec]:
    """The messages of the DBC that occur in a log, in the DBC's order."""
    decoder = Decoder(codec)
    found: set[int] = set()
    for block in blocks:
        found.update(np.unique(decoder.match(block)).tolist())
    return [m for m in codec.messages if m.index in found]


def columns(messages: Collection[MessageSpec]) -> Iterator[tuple[str, MessageSpec, int]]:
    """(`Message.Signal`, message, place of the signal in it) of every signal."""
    for message in messages:
        for place, signal in enumerate(message.signals):
            yield f"{message.name}.{signal.name}", message, place
