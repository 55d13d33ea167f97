"""Whether an MF4 file has all the parts that it names; looked at after asammdf has refused it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO, Final, NamedTuple

HEADER: Final = struct.Struct("<4s4xQQ")
"""Kind, length and number of links of a block."""
FIRST: Final = 64
"""Where the first block is, behind the identification."""
_MARK: Final = b"##"
_MOST_BLOCKS: Final = 100_000
_MOST_LINKS: Final = 1_000_000


class Block(NamedTuple):
    """Its head. size: as it says; links: places of other blocks or 0; data_at: behind them."""

    kind: bytes
    size: int
    links: tuple[int, ...]
    data_at: int


def block_at(stream: IO[bytes], at: int) -> Block:
    """The block at this place. Raises ValueError for none, struct.error where it is cut."""
    stream.seek(at)
    kind, size, count = HEADER.unpack(stream.read(HEADER.size))
    if kind[:2] != _MARK or size < HEADER.size or count > _MOST_LINKS:
        raise ValueError(at)
    data = stream.read(8 * count)
    return Block(kind, size, struct.unpack(f"<{count}Q", data), at + HEADER.size + len(data))


def missing_part(source: Path | IO[bytes]) -> str:
    """How an MF4 file is shorter than it says, in words; empty if it is not.

    source: a file, or a stream that can be read from any place.
    """
    try:
        if not isinstance(source, Path):
            return _missing_part(source)
        with source.open("rb") as stream:
            return _missing_part(stream)
    except (OSError, ValueError):  # a stream that is closed, for one
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
                f"the file is cut: it has {size} bytes, and by its own index one of its parts is "
                f"at bytes {at} to {end}"
            )
        waiting += links - known
        known.update(links)
    return ""


def _extent(stream: IO[bytes], at: int, size: int) -> tuple[int, set[int]]:
    """Where a block ends, and the blocks that it names."""
    try:
        block = block_at(stream, at)
    except ValueError:  # damaged, not cut
        return at, set()
    except struct.error:
        return max(at + HEADER.size, size + 1), set()
    end = at + block.size
    return end, set(block.links) - {0} if end <= size and block.data_at <= end else set()
