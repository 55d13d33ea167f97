"""Vector's BLF: its frames, and a count of every object that is none.

Own, because python-can's reader takes times before the trigger for the year 2554 and ends in a
traceback, has them as floats, and passes over objects and a cut file in silence
(docs/upstream/blf.md). The layout of the objects is that of python-can. The clock of the file's
start is that of the recording machine, in no named zone: it is read as UTC.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogError
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, SECOND, TX, Frame
from dbc.frames import MAX_DATA_BYTES, Block, block_of
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES
from dbc.logs.objects import BLOCK, ObjectReader

FILE: Final = struct.Struct("<4sLBBBBBBBBQQLL8H8H")
"""Signature, size of the header, versions, sizes of the file, objects, start, stop."""
BASE: Final = struct.Struct("<4sHHLL")
"""Signature, size of the header, its version, size and kind of the object."""
_STAMP: Final = {1: struct.Struct("<LHHQ"), 2: struct.Struct("<LBxHQ")}
CONTAINER: Final = struct.Struct("<H6xL4x")
CLASSIC: Final = struct.Struct("<HBBL8s")
FD_MESSAGE: Final = struct.Struct("<HBBLLBBB5x64s")
_FD_64: Final = struct.Struct("<BBBBLLLLLLLHBBL")
ERROR_EXT: Final = struct.Struct("<HHLBBBxLLH2x8s")
_MESSAGES, ERROR_EXT_KIND, CONTAINER_KIND = (1, 86), 73, 10
FD_KIND, _FD_64_KIND, _ERRORS = 100, 101, (2, 104)
_MOST_BYTES: Final = 1 << 26
"""Of a container: real ones have 128 kB, and a size that is damaged must not become memory."""
_SEARCH: Final = 1 << 16
_SIGNATURE, _MANY = int.from_bytes(b"LOBJ", "little"), 8
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
_LONG_ID, _REMOTE_FLAG, SENT_FLAG = 0x8000_0000, 0x80, 1


class Blf(ObjectReader):
    """One file."""

    def blocks(self) -> Iterator[Block]:
        """See `ObjectReader.blocks`."""
        self._reset()
        held: list[Frame] = []
        for item in self._items():
            if isinstance(item, Frame):
                held.append(item)
            if held and (len(held) == BLOCK or not isinstance(item, Frame)):
                yield self._held(held)
            if isinstance(item, Block):
                self._count(item)
                yield item
        if held:
            yield self._held(held)
        self._end()

    def _held(self, held: list[Frame]) -> Block:
        block = block_of(held)
        held.clear()
        self._count(block)
        return block

    def frames(self) -> Iterator[Frame]:
        """All of them, one by one."""
        for block in self.blocks():
            yield from block.frames()

    def _items(self) -> Iterator[Frame | Block]:
        """Frames, and runs of them. Raises LogError for what is no BLF."""
        with ExitStack() as stack:
            stream = self._open(stack)
            self._start_ns, promised = self._header(stream)
            rest = b""
            for data in self._containers(stream):
                rest = yield from self._objects(rest + data)
        if rest.strip(b"\0"):
            self.truncated = self.truncated or "in the middle of an object"
        elif self.bytes_read < promised:
            self.truncated = self.truncated or f"{self.bytes_read} of {promised} bytes"

    def _header(self, stream: IO[bytes]) -> tuple[int, int]:
        """Nanoseconds since 1970 of the start, and how long the file should be."""
        head = self._read(stream, FILE.size)
        if len(head) < FILE.size or head[:4] != b"LOGG":
            raise LogError(self.name, 0, "cannot be read: no BLF (it does not begin with LOGG)")
        fields = FILE.unpack(head)
        self._read(stream, max(min(fields[1], _SEARCH) - FILE.size, 0))
        start_ns = _system_time_ns(fields[14:22])
        if not start_ns:
            self.notes.append("the file has no start time: its times count from 0")
        return start_ns, fields[10]

    def _read(self, stream: IO[bytes], size: int) -> bytes:
        try:
            data = stream.read(size)
        except (EOFError, OSError, zlib.error) as error:  # of gzip
            if not self.zipped:
                raise
            self.truncated = f"compressed data end early or are damaged ({error})"
            return b""
        self.bytes_read += len(data)
        return data

    def _containers(self, stream: IO[bytes]) -> Iterator[bytes]:
        """What is inside of them, and objects that stand outside, as they are."""
        while head := self._read(stream, BASE.size):
            if len(head) < BASE.size:
                if head.strip(b"\0"):
                    self.truncated = "in the middle of a container's header"
                return
            signature, _, _, size, kind = BASE.unpack(head)
            if signature != b"LOBJ" or not BASE.size <= size <= _MOST_BYTES:
                if not head.strip(b"\0"):
                    continue
                self._fault(Verdict.MALFORMED, f"no object at byte {self.bytes_read - BASE.size}")
                if not self._resume(stream):
                    return
                continue
            body = self._read(stream, size - BASE.size)
            if len(body) < size - BASE.size:
                self.truncated = "in the middle of a container"
            self._read(stream, size % 4)
            if kind != CONTAINER_KIND:
                yield head + body + bytes(-size % 4)
            elif len(body) >= CONTAINER.size:
                yield self._unpacked(body)

    def _resume(self, stream: IO[bytes]) -> bool:
        """Go to the next object. False at the end."""
        window = b""
        while piece := self._read(stream, _SEARCH):
            window = window[-3:] + piece
            if (at := window.find(b"LOBJ")) >= 0:
                back = len(window) - at
                stream.seek(-back, 1)
                self.bytes_read -= back
                return True
        return False

    def _unpacked(self, body: bytes) -> bytes:
        method, _ = CONTAINER.unpack_from(body)
        data = body[CONTAINER.size :]
        if method == 0:
            return data
        if method != 2:
            self._fault(Verdict.MALFORMED, f"a container of unknown compression {method}")
            return b""
        unpack = zlib.decompressobj()
        try:
            return unpack.decompress(data, _MOST_BYTES)
        except zlib.error as error:
            self._fault(Verdict.MALFORMED, f"a container is damaged ({error})")
            return b""

    def _objects(self, data: bytes) -> Generator[Frame | Block, None, bytes]:
        """Frames of complete objects; returns what is left."""
        at = 0
        while True:
            found = data.find(b"LOBJ", at, at + 8)
            if found < 0:
                if len(data) - at < 8:
                    return data[at:]
                found = data.find(b"LOBJ", at)
                self._fault(Verdict.MALFORMED, "bytes between objects that are none")
                if found < 0:
                    return b""
            at = found
            if at + BASE.size > len(data):
                return data[at:]
            _, header, version, size, kind = BASE.unpack_from(data, at)
            if not BASE.size <= size <= _MOST_BYTES:
                self._fault(Verdict.MALFORMED, f"an object of {size} bytes")
                at += 4
                continue
            if at + size > len(data):
                return data[at:]
            if kind in _MESSAGES and (objects := _run(data, at, size)) is not None:
                yield _classic(objects, self._start_ns)
                at += size * len(objects)
                continue
            try:
                frame = self._frame(data, at, (header, version, size, kind))
            except (struct.error, ValueError, IndexError):
                self._fault(Verdict.MALFORMED, f"an object of kind {kind} that is too short")
            else:
                if isinstance(frame, Frame):
                    yield frame
                elif frame is not None and frame.is_fault:
                    self._fault(frame, f"an object of kind {kind} that is no frame")
                elif frame is not None:
                    self._skip(frame)
            at += size

    def _frame(
        self, data: bytes, at: int, fields: tuple[int, int, int, int]
    ) -> Frame | Verdict | None:
        """Of an object; why it is none. None: it was a fault."""
        header, version, size, kind = fields
        if version not in _STAMP:
            self._fault(Verdict.MALFORMED, f"an object with a header of version {version}")
            return None
        flags, _, _, raw = _STAMP[version].unpack_from(data, at + BASE.size)
        raw -= 1 << 64 if raw >> 63 else 0
        t_ns = self._start_ns + raw * (10_000 if flags == 1 else 1)
        if not -(1 << 62) < t_ns < 1 << 62:
            return Verdict.MALFORMED
        if header < BASE.size + 16:
            header = BASE.size + (16 if version == 1 else 24)
        body = at + header
        if kind in _MESSAGES:
            channel, bits, dlc, can_id, content = CLASSIC.unpack_from(data, body)
            kept = (EXTENDED if can_id & _LONG_ID else 0) | (TX if bits & SENT_FLAG else 0)
            can_id &= 0x1FFF_FFFF
            if bits & _REMOTE_FLAG:
                return _checked(Frame(t_ns, can_id, b"", kept | REMOTE, _name(channel), dlc or -1))
            raw_dlc = dlc if dlc > CLASSIC_BYTES else -1
            return _checked(Frame(t_ns, can_id, content[:dlc], kept, _name(channel), raw_dlc))
        if kind == FD_KIND:
            channel, bits, dlc, can_id, _, _, fd, valid, content = FD_MESSAGE.unpack_from(
                data, body
            )
            words = (fd & 1, fd & 2, fd & 4, bits & _REMOTE_FLAG, bits & SENT_FLAG)
            return _fd(t_ns, channel, can_id, words, dlc, content[:valid])
        if kind == _FD_64_KIND:
            return self._fd_64(t_ns, data[at : at + size], header)
        if kind == ERROR_EXT_KIND:
            members = ERROR_EXT.unpack_from(data, body)
            content = members[9][: min(members[5], CLASSIC_BYTES)]
            return Frame(t_ns, members[7] & 0x1FFF_FFFF, content, ERROR, _name(members[0]))
        if kind in _ERRORS:
            number = (
                data[body]
                if kind != _ERRORS[0]
                else int.from_bytes(data[body : body + 2], "little")
            )
            return Frame(t_ns, 0, b"", ERROR, _name(number))
        return Verdict.EVENT

    def _fd_64(self, t_ns: int, data: bytes, header: int) -> Frame | Verdict:
        fields = _FD_64.unpack_from(data, header)
        channel, dlc, valid, _, can_id, _, bits = fields[:7]
        # `valid` may be more than there is: CANoe then fills up with zeros.
        start = header + _FD_64.size
        content = data[start : min(start + valid, fields[13] or len(data))].ljust(valid, b"\0")
        words = (bits & 0x1000, bits & 0x2000, bits & 0x4000, bits & 0x10, fields[12])
        return _fd(t_ns, channel, can_id, words, dlc, content)


def _run(data: bytes, at: int, size: int) -> NDArray[np.void] | None:
    """Objects of classic frames of one size that follow one another, if there are many."""
    if size not in _CLASSIC_OBJECT:
        return None
    objects = np.frombuffer(data, _CLASSIC_OBJECT[size], (len(data) - at) // size, at)
    long = objects["can_id"] & _LONG_ID != 0
    stamps = np.where(objects["flags"] == 1, _SOON // 10_000, _SOON)
    same = (
        (objects["signature"] == _SIGNATURE) & (objects["size"] == size)
        & np.isin(objects["kind"], _MESSAGES) & (objects["version"] == 1)
        & (objects["dlc"] <= 15) & (long | (objects["can_id"] <= 0x7FF))
        & (objects["stamp"] < stamps) & (objects["stamp"] > -stamps)
    )  # fmt: skip
    count = len(same) if same.all() else int(np.argmin(same))
    return objects[:count] if count >= _MANY else None


def _classic(objects: NDArray[np.void], start_ns: int) -> Block:
    """Their frames."""
    count = len(objects)
    dlc = objects["dlc"].astype(np.int8)
    remote = objects["bits"] & _REMOTE_FLAG != 0
    length = np.where(remote, 0, np.minimum(dlc, CLASSIC_BYTES)).astype(np.uint8)
    rows = np.zeros((count, MAX_DATA_BYTES), np.uint8)
    rows[:, :CLASSIC_BYTES] = objects["data"]
    rows[:, :CLASSIC_BYTES][np.arange(CLASSIC_BYTES) >= length[:, None]] = 0
    flags = np.where(objects["can_id"] & _LONG_ID, EXTENDED, 0) | np.where(remote, REMOTE, 0)
    flags |= np.where(objects["bits"] & SENT_FLAG, TX, 0)
    known = (remote & (dlc > 0)) | (~remote & (dlc > CLASSIC_BYTES))
    numbers, places = np.unique(objects["channel"], return_inverse=True)
    unit = np.where(objects["flags"] == 1, 10_000, 1)
    return Block(
        start_ns + objects["stamp"] * unit, objects["can_id"] & np.uint32(0x1FFF_FFFF),
        flags.astype(np.uint8), length, rows, np.where(known, dlc, -1).astype(np.int8),
        places.astype(np.uint16), [_name(number) for number in numbers.tolist()],
    )  # fmt: skip


def _fd(
    t_ns: int, channel: int, can_id: int, words: tuple[int, ...], dlc: int, data: bytes
) -> Frame | Verdict:
    """A frame of the CAN FD objects, which hold classic ones, too.

    words: FD, BRS, ESI, remote, sent.
    """
    fd, brs, esi, remote, sent = words
    flags = (EXTENDED if can_id & _LONG_ID else 0) | (TX if sent else 0)
    can_id &= 0x1FFF_FFFF
    if remote:
        return _checked(Frame(t_ns, can_id, b"", flags | REMOTE, _name(channel), dlc or -1))
    if fd:
        flags |= FD | (BRS if brs else 0) | (ESI if esi else 0)
    return _checked(Frame(t_ns, can_id, data, flags, _name(channel)))


def _checked(frame: Frame) -> Frame | Verdict:
    if frame.can_id > 0x7FF and not frame.flags & EXTENDED:
        return Verdict.BAD_ID
    size = len(frame.data)
    if not (size in FD_SIZES if frame.flags & FD else size <= CLASSIC_BYTES) or frame.dlc > 15:
        return Verdict.BAD_LENGTH
    return frame


def _name(channel: int) -> str:
    """Vector counts from 1."""
    return str(channel - 1 if channel else 0)


def _system_time_ns(fields: tuple[int, ...]) -> int:
    """Of Windows' SYSTEMTIME; 0 where it is none."""
    year, month, _, day, hour, minute, second, ms = fields
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0
    return round(moment.timestamp()) * SECOND + ms * 1_000_000
