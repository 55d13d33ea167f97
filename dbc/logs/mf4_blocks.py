"""Check whether an MF4 file has all blocks that it links; used after asammdf has rejected it."""

from __future__ import annotations

import struct
from contextlib import nullcontext
from pathlib import Path
from typing import IO, Final, NamedTuple

HEADER: Final = struct.Struct("<4s4xQQ")
"""Kind, length and number of links of a block."""
FIRST: Final = 64
"""Position of the first block, behind the identification."""
_MARK: Final = b"##"
_MOST_BLOCKS: Final = 100_000
_MOST_LINKS: Final = 1_000_000


class Block(NamedTuple):
    """Head of a block. size: as stated; links: positions of blocks, or 0; data_at: behind them."""

    kind: bytes
    size: int
    links: tuple[int, ...]
    data_at: int


def block_at(stream: IO[bytes], at: int) -> Block:
    """The block at this position. Raises ValueError if none is there, struct.error if it is cut."""
    stream.seek(at)
    kind, size, count = HEADER.unpack(stream.read(HEADER.size))
    if kind[:2] != _MARK or size < HEADER.size or count > _MOST_LINKS:
        raise ValueError(at)
    data = stream.read(8 * count)
    return Block(kind, size, struct.unpack(f"<{count}Q", data), at + HEADER.size + len(data))


def missing_part(source: Path | IO[bytes]) -> str:
    """Message that an MF4 file is shorter than its links require; empty if it is not.

    source: a file, or a stream with random access.
    """
    try:
        with source.open("rb") if isinstance(source, Path) else nullcontext(source) as stream:
            return _missing_part(stream)
    except (OSError, ValueError):  # for example a closed stream
        return ""


def _missing_part(stream: IO[bytes]) -> str:
    size = stream.seek(0, 2)
    stream.seek(0)
    if stream.read(3) != b"MDF":
        return ""
    waiting, known = [FIRST], {FIRST}
    while waiting and len(known) < _MOST_BLOCKS:
        at = waiting.pop()
        end, links = _extent(stream, at, size)
        if end > size:
            return (
                f"the file is cut: it has {size} bytes, but its index places a block at bytes "
                f"{at} to {end}"
            )
        waiting += links - known
        known.update(links)
    return ""


def _extent(stream: IO[bytes], at: int, size: int) -> tuple[int, set[int]]:
    """End of a block, and the positions of the blocks that it links."""
    try:
        block = block_at(stream, at)
    except ValueError:  # damaged, not cut
        return at, set()
    except struct.error:
        return max(at + HEADER.size, size + 1), set()
    end = at + block.size
    return end, set(block.links) - {0} if end <= size and block.data_at <= end else set()
