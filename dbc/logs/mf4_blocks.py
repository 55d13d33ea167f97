"""Whether an MF4 file has all the parts that it names; looked at after asammdf has refused it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO, Final

_HEADER: Final = struct.Struct("<2s2s4xQQ")
"""Mark, kind, length and number of links of a block."""
_FIRST: Final = 64
"""Where the first block is, behind the identification."""
_MARK: Final = b"##"
_MOST_BLOCKS: Final = 100_000


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
    waiting, known = [_FIRST], {_FIRST}
    while waiting and len(known) < _MOST_BLOCKS:
        at = waiting.pop()
        end, links = _block(stream, at, size)
        if end > size:
            return (
                f"the file is cut: it has {size} bytes, and by its own index one of its parts is "
                f"at bytes {at} to {end}"
            )
        waiting += set(links) - known
        known.update(links)
    return ""


def _block(stream: IO[bytes], at: int, size: int) -> tuple[int, tuple[int, ...]]:
    """Where a block ends, and the blocks that it names."""
    if at + _HEADER.size > size:
        return at + _HEADER.size, ()
    stream.seek(at)
    mark, _, length, count = _HEADER.unpack(stream.read(_HEADER.size))
    if mark != _MARK or not _HEADER.size <= length:
        return at, ()  # damaged, not cut
    if at + length > size or _HEADER.size + 8 * count > length:
        return at + length, ()
    links = struct.unpack(f"<{count}Q", stream.read(8 * count))
    return at + length, tuple(link for link in links if link)
