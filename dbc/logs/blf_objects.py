"""Layout of the objects of a BLF, and the frames in them; pure.

The layout is that of python-can. Nothing beyond the end of an object is read, because the bytes
there belong to the next one.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES

SIGNATURE: Final = b"LOBJ"
FILE: Final = struct.Struct("<4sLBBBBBBBBQQLL8H8H")
"""Signature, size of the header, versions, sizes of the file, objects, start, stop."""
BASE: Final = struct.Struct("<4sHHLL")
"""Signature, size of the header, its version, size and kind of the object."""
_STAMP: Final = {1: struct.Struct("<LHHQ"), 2: struct.Struct("<LBxHQ")}
CONTAINER: Final = struct.Struct("<H6xL4x")
"""Compression method, and size of the content before compression."""
CLASSIC: Final = struct.Struct("<HBBL8s")
FD_MESSAGE: Final = struct.Struct("<HBBLLBBB5x64s")
_CLASSIC_HEAD: Final = struct.Struct("<HBBL")
_FD_HEAD: Final = struct.Struct("<HBBLLBBB5x")
_FD_64: Final = struct.Struct("<BBBBLLLLLLLHBBL")
ERROR_EXT: Final = struct.Struct("<HHLBBBxLLH2x8s")
MESSAGES, ERROR_EXT_KIND, CONTAINER_KIND = (1, 86), 73, 10
FD_KIND, _FD_64_KIND, _ERRORS = 100, 101, (2, 104)
RESTORE_POINT_KIND: Final = 115
"""Kind of object that Vector's count of objects leaves out."""
MOST_BYTES: Final = 1 << 26
"""Largest container: real ones have 128 kB, and a damaged size must not allocate memory."""
MOST_OF: Final = dict.fromkeys((*MESSAGES, ERROR_EXT_KIND, FD_KIND, _FD_64_KIND, *_ERRORS), 1 << 10)
"""Most bytes of an object, for kinds whose size is known."""
_HEADERS: Final = range(BASE.size, 65)
_MOST_KINDS: Final = 1 << 10
_GAP: Final = 8
"""Fewer bytes than these lie between two objects."""
_NUMBER, _MANY = int.from_bytes(SIGNATURE, "little"), 8
_SOON: Final = 1 << 60
CLASSIC_FIELDS: Final = [
    ("signature", "<u4"), ("header", "<u2"), ("version", "<u2"), ("size", "<u4"), ("kind", "<u4"),
    ("flags", "<u4"), ("client", "<u2"), ("object", "<u2"), ("stamp", "<i8"), ("channel", "<u2"),
    ("bits", "u1"), ("dlc", "u1"), ("can_id", "<u4"), ("data", "u1", 8),
]  # fmt: skip
"""An object of a classic frame, with a header of version 1."""
_CLASSIC_OBJECT: Final = {
    48: np.dtype(CLASSIC_FIELDS), 56: np.dtype([*CLASSIC_FIELDS, ("more", "u1", 8)]),
}  # fmt: skip
_LONG_ID, _REMOTE_FLAG = 0x8000_0000, 0x80
_DIRECTION, SENT_FLAG, _REQUESTED = 0x0F, 1, 2
"""Vector's CAN_MSG_DIR: 0 received, 1 sent, 2 requested but not yet confirmed."""


def is_followed(data: bytes, end: int) -> bool:
    """Whether an object, padding or the end of the data follows the position `end`."""
    after = data[end : end + _GAP]
    if len(after) < _GAP or SIGNATURE in after:
        return True
    return not any(after) and not data[end:].strip(b"\0")


def find_object(data: bytes, at: int) -> int:
    """Position of the next real object, -1 if none; data of a frame can look like its start."""
    while (at := data.find(SIGNATURE, at)) >= 0:
        if len(data) - at < BASE.size:
            return at
        _, header, version, size, kind = BASE.unpack_from(data, at)
        likely = version in _STAMP and header in _HEADERS and kind < _MOST_KINDS
        if (
            likely
            and header <= size <= MOST_OF.get(kind, MOST_BYTES)
            and is_followed(data, at + size)
        ):
            return at
        at += len(SIGNATURE)
    return -1


def find_container(data: bytes) -> int:
    """Position of another container in the content of one; -1 if there is none."""
    at = 0
    while (at := data.find(SIGNATURE, at)) >= 0 and len(data) - at >= BASE.size:
        _, header, version, size, kind = BASE.unpack_from(data, at)
        if (header, version, kind) == (BASE.size, 1, CONTAINER_KIND) and size <= MOST_BYTES:
            return at
        at += len(SIGNATURE)
    return -1


def frame_of(
    data: bytes, fields: tuple[int, int, int, int], start_ns: int
) -> Frame | Verdict | str:
    """Frame of one object, a Verdict if it has none, or a text that describes its fault.

    fields: size and version of the header, size and kind of the object.
    Raises struct.error or IndexError for an object that is too short for its kind.
    """
    header, version, _, kind = fields
    if kind not in MOST_OF:
        return Verdict.EVENT
    if version not in _STAMP:
        return f"an object with a header of version {version}"
    flags, _, _, raw = _STAMP[version].unpack_from(data, BASE.size)
    raw -= 1 << 64 if raw >> 63 else 0
    t_ns = start_ns + raw * (10_000 if flags == 1 else 1)
    if not -(1 << 62) < t_ns < 1 << 62:
        return "a time that no frame has"
    if header < BASE.size + 16:
        header = BASE.size + (16 if version == 1 else 24)
    if kind in MESSAGES:
        channel, bits, dlc, can_id = _CLASSIC_HEAD.unpack_from(data, header)
        content = data[header + _CLASSIC_HEAD.size :]
        words = (False, False, False, bits & _REMOTE_FLAG, bits & _DIRECTION)
        return _message(t_ns, channel, can_id, words, dlc, content, min(dlc, CLASSIC_BYTES))
    if kind == FD_KIND:
        channel, bits, dlc, can_id, _, _, fd, valid = _FD_HEAD.unpack_from(data, header)
        content = data[header + _FD_HEAD.size :]
        words = (fd & 1, fd & 2, fd & 4, bits & _REMOTE_FLAG, bits & _DIRECTION)
        return _message(t_ns, channel, can_id, words, dlc, content, valid)
    if kind == _FD_64_KIND:
        return _fd_64(t_ns, data, header)
    if kind == ERROR_EXT_KIND:
        members = ERROR_EXT.unpack_from(data, header)
        content = members[9][: min(members[5], CLASSIC_BYTES)]
        return Frame(t_ns, members[7] & 0x1FFF_FFFF, content, ERROR, _name(members[0]))
    wide = kind == _ERRORS[0]
    number = int.from_bytes(data[header : header + 2], "little") if wide else data[header]
    return Frame(t_ns, 0, b"", ERROR, _name(number))


def _fd_64(t_ns: int, data: bytes, header: int) -> Frame | Verdict | str:
    fields = _FD_64.unpack_from(data, header)
    channel, dlc, valid, _, can_id, _, bits = fields[:7]
    # `valid` may exceed the bytes that are there; CANoe then pads with zeros (python-can, 1905).
    start = header + _FD_64.size
    content = data[start : min(start + valid, fields[13] or len(data))].ljust(valid, b"\0")
    words = (bits & 0x1000, bits & 0x2000, bits & 0x4000, bits & 0x10, fields[12])
    return _message(t_ns, channel, can_id, words, dlc, content, valid)


def _message(
    t_ns: int, channel: int, can_id: int, words: tuple[int, ...], dlc: int, data: bytes, valid: int
) -> Frame | Verdict | str:
    """A data or remote frame with the length of its DLC; missing bytes are zero.

    words: FD, BRS, ESI, remote, direction; valid: bytes of `data` that belong to the frame.
    """
    fd, brs, esi, remote, direction = words
    if direction == _REQUESTED:
        return Verdict.REQUEST
    flags = (EXTENDED if can_id & _LONG_ID else 0) | (TX if direction & SENT_FLAG else 0)
    if can_id & 0x1FFF_FFFF > 0x7FF and not flags & EXTENDED:
        return Verdict.BAD_ID
    can_id &= 0x1FFF_FFFF
    if dlc >= len(FD_SIZES) and not (fd and valid in FD_SIZES):
        return Verdict.BAD_LENGTH
    if remote:
        return Frame(t_ns, can_id, b"", flags | REMOTE, _name(channel), dlc or -1)
    if valid > len(data):
        return f"an object with {len(data)} of {valid} bytes of data"
    size = min(dlc, CLASSIC_BYTES)
    if fd:
        size = FD_SIZES[dlc] if dlc < len(FD_SIZES) else valid
    data = data[: valid if valid < size else size]
    if valid < size:
        data = data.ljust(size, b"\0")
    if fd:
        flags |= FD | (BRS if brs else 0) | (ESI if esi else 0)
        return Frame(t_ns, can_id, data, flags, _name(channel))
    return Frame(t_ns, can_id, data, flags, _name(channel), dlc if dlc > CLASSIC_BYTES else -1)


def run_of(data: bytes, at: int, size: int) -> NDArray[np.void] | None:
    """Consecutive objects of classic frames of one size; None if they are fewer than `_MANY`."""
    if size not in _CLASSIC_OBJECT:
        return None
    objects = np.frombuffer(data, _CLASSIC_OBJECT[size], (len(data) - at) // size, at)
    long = objects["can_id"] & _LONG_ID != 0
    stamps = np.where(objects["flags"] == 1, _SOON // 10_000, _SOON)
    same = (
        (objects["signature"] == _NUMBER) & (objects["size"] == size)
        & np.isin(objects["kind"], MESSAGES) & (objects["version"] == 1)
        & (objects["dlc"] <= 15) & (long | (objects["can_id"] <= 0x7FF))
        & (objects["stamp"] < stamps) & (objects["stamp"] > -stamps)
    )  # fmt: skip
    count = len(same) if same.all() else int(np.argmin(same))
    if count and not is_followed(data, at + count * size):
        count -= 1
    return objects[:count] if count >= _MANY else None


def frames_of_run(objects: NDArray[np.void], start_ns: int) -> Block:
    """Frames of the objects of a run, without those that are only requests to send."""
    bits = objects["bits"].copy()
    requested = bits & _DIRECTION == _REQUESTED
    if requested.any():
        objects, bits = objects[~requested], bits[~requested]
    count = len(objects)
    dlc = objects["dlc"].astype(np.int8)
    remote = bits & _REMOTE_FLAG != 0
    length = np.where(remote, 0, np.minimum(dlc, CLASSIC_BYTES)).astype(np.uint8)
    rows = np.zeros((count, MAX_DATA_BYTES), np.uint8)
    rows[:, :CLASSIC_BYTES] = objects["data"]
    rows[:, :CLASSIC_BYTES][np.arange(CLASSIC_BYTES) >= length[:, None]] = 0
    can_id = objects["can_id"].copy()
    flags = np.where(can_id & _LONG_ID, EXTENDED, 0) | np.where(remote, REMOTE, 0)
    flags |= np.where(bits & SENT_FLAG, TX, 0)
    known = (remote & (dlc > 0)) | (~remote & (dlc > CLASSIC_BYTES))
    numbers, places = np.unique(objects["channel"], return_inverse=True)
    unit = np.where(objects["flags"] == 1, 10_000, 1)
    return Block(
        start_ns + objects["stamp"] * unit, can_id & np.uint32(0x1FFF_FFFF),
        flags.astype(np.uint8), length, rows, np.where(known, dlc, -1).astype(np.int8),
        places.astype(np.uint16), [_name(number) for number in numbers.tolist()],
    )  # fmt: skip


@lru_cache(256)
def _name(channel: int) -> str:
    """Name of a channel, counted from 0; Vector counts from 1."""
    return str(channel - 1 if channel else 0)
