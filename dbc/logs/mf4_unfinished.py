"""MF4 files that their recorder has not closed (`UnFinMF`): find the end of the last whole record.

A CANedge writes such a file until it loses its power, so the last record may be cut anywhere.
asammdf takes the rest of that record for a whole one, or rejects the file.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import IO, Final

from dbc.logs.mf4_blocks import FIRST, HEADER, block_at

_IS_VLSD: Final = 1
"""Flag of a group whose records begin with their own length."""
_LENGTH: Final = struct.Struct("<L")
_PIECE: Final = 1 << 20
_MOST_BLOCKS: Final = 10_000


def end_of_records(stream: IO[bytes]) -> tuple[int, int] | None:
    """The byte behind the last whole record, and the size of the file.

    None if it cannot be found, because the file is damaged or has another structure.
    """
    size = stream.seek(0, 2)
    try:
        group = _last_group(stream)
        if group is None:
            return None
        records_at, id_bytes, sizes = group
        return _walk(stream, records_at, id_bytes, sizes), size
    except (struct.error, ValueError, IndexError, KeyError):
        return None


def _last_group(stream: IO[bytes]) -> tuple[int, int, Mapping[int, int]] | None:
    """Position of the last records, size of a record's number, and size of a record by its number.

    A size of -1 means that each record begins with its own length.
    """
    found = None
    at = block_at(stream, FIRST).links[0]
    for _ in range(_MOST_BLOCKS):
        if not at:
            break
        group = block_at(stream, at)
        at, channels_at, data_at = group.links[:3]
        if not data_at or block_at(stream, data_at).kind != b"##DT":
            continue
        if found is None or data_at > found[0]:
            stream.seek(group.data_at)
            found = data_at, stream.read(1)[0], _sizes(stream, channels_at)
    return None if found is None else (found[0] + HEADER.size, found[1], found[2])


def _sizes(stream: IO[bytes], at: int) -> dict[int, int]:
    out = {}
    for _ in range(_MOST_BLOCKS):
        if not at:
            break
        group = block_at(stream, at)
        stream.seek(group.data_at)
        number, _, flags, data, invalid = struct.unpack("<QQH6xLL", stream.read(32))
        out[number] = -1 if flags & _IS_VLSD else data + invalid
        at = group.links[0]
    return out


def _walk(stream: IO[bytes], at: int, id_bytes: int, sizes: Mapping[int, int]) -> int:
    """The byte behind the last whole record. Raises KeyError for a record of no group.

    The data of a frame may be a separate record, before or behind the frame's: both must be whole.
    """
    stream.seek(at)
    rest, first_is_long = b"", None
    behind: dict[bool, int] = {}
    while piece := stream.read(_PIECE):
        data, place = rest + piece, 0
        while place + id_bytes + _LENGTH.size <= len(data):
            number = int.from_bytes(data[place : place + id_bytes], "little")
            size = sizes[number]
            is_long = size < 0
            first_is_long = is_long if first_is_long is None else first_is_long
            if is_long:
                size = _LENGTH.size + _LENGTH.unpack_from(data, place + id_bytes)[0]
            if place + id_bytes + size > len(data):
                break
            place += id_bytes + size
            behind[is_long] = at + place
        rest = data[place:]
        at += place
    return behind.get(not first_is_long, at)
