"""Blocks of frames as decoded signals, for files: what a DBC makes of a log, and what it does not.

Nothing is judged here: a frame with a wrong checksum or counter is decoded like any other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import ERROR, EXTENDED, FD, REMOTE
from dbc.frames import ROOM, Block
from dbc.spec import ABSENT, EXTENDED_KEY, VALID, Match, MessageSpec, Validity


class Decoded(NamedTuple):
    """Frames of a DBC: n of them in their order.

    frames: n frames; message (n,) int32, its `MessageSpec.index`; value (n, S) as
    `Codec.decode_rows`, NaN where the frame has no valid value.
    """

    frames: Block
    message: NDArray[np.int32]
    value: NDArray[np.float64]


class Decoder:
    """Decodes blocks; `counts` (Match -> frames) and `cells` (Validity -> values) are of all."""

    def __init__(self, codec: Codec) -> None:
        """Nothing is read."""
        self.codec = codec
        self.counts: Counter[Match] = Counter()
        self.cells: Counter[Validity] = Counter()
        ordered = sorted(codec.messages, key=lambda m: m.key)
        self._keys = np.array([m.key for m in ordered], dtype=np.int64)
        self._index = np.array([m.index for m in ordered], dtype=np.int32)
        self._fd = np.array([m.is_fd for m in ordered], dtype=np.bool_)
        self._length = np.array([m.length for m in ordered], dtype=np.int64)

    def match(self, block: Block) -> NDArray[np.int32]:
        """`MessageSpec.index` of every frame, -1 where it is not to be decoded. Counts why."""
        flags = block.flags
        keys = block.can_id.astype(np.int64) | np.where(flags & EXTENDED, EXTENDED_KEY, 0)
        place = np.searchsorted(self._keys, keys).clip(max=max(len(self._keys) - 1, 0))
        known = (
            self._keys[place] == keys if len(self._keys) else np.zeros(block.size, dtype=np.bool_)
        )
        said = np.full(block.size, Match.UNKNOWN_ID, dtype=np.uint8)
        if known.any():
            said[known] = Match.OK
            said[known & (self._length[place] != block.length)] = Match.WRONG_LENGTH
            said[known & (self._fd[place] != (flags & FD != 0))] = Match.WRONG_FORMAT
        said[flags & REMOTE != 0] = Match.REMOTE
        said[flags & ERROR != 0] = Match.ERROR_FRAME
        for number, count in enumerate(np.bincount(said, minlength=len(Match)).tolist()):
            if count:
                self.counts[Match(number)] += count
        good = said == Match.OK
        index = np.full(block.size, -1, dtype=np.int32)
        index[good] = self._index[place[good]]
        return index

    def decode(self, block: Block) -> Decoded:
        """The frames of the DBC among these, decoded."""
        index = self.match(block)
        good = index >= 0
        frames, index = block.pick(good), index[good]
        value, validity = self.codec.decode_rows(index, frames.data[:, :ROOM])
        for number, count in enumerate(np.bincount(validity.ravel()).tolist()):
            if count and number != ABSENT:
                self.cells[Validity(number)] += count
        value[validity != VALID] = np.nan
        return Decoded(frames, index, value)


def seen(blocks: Iterable[Block], codec: Codec) -> list[MessageSpec]:
    """The messages of the DBC that a log holds, in the DBC's order."""
    decoder = Decoder(codec)
    found: set[int] = set()
    for block in blocks:
        found.update(np.unique(decoder.match(block)).tolist())
    return [m for m in codec.messages if m.index in found]


def columns(messages: Collection[MessageSpec]) -> Iterator[tuple[str, MessageSpec, int]]:
    """`Message.Signal`, its message, and its place there."""
    for message in messages:
        for place, signal in enumerate(message.signals):
            yield f"{message.name}.{signal.name}", message, place
