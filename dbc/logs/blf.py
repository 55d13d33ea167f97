"""Vector's BLF: its frames, and a count of all other objects.

This module exists because python-can's reader takes times before the trigger for the year 2554 and
ends in a traceback, has times as floats, and does not report skipped objects or a truncated file
(docs/upstream/blf.md). The start time of the file is that of the recording machine, without a time
zone: it is read as UTC.

An object may begin in one container and end in the next. Where a container is damaged, or bytes are
missing, no part of an object is carried over: reading continues with the next whole object, and the
loss is counted.
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
from dbc.frame import SECOND, Frame
from dbc.frames import Block, block_of
from dbc.logs import blf_objects as layout
from dbc.logs.objects import BLOCK, ObjectReader

_SEARCH: Final = 1 << 16
_YEARS: Final = range(1970, 2200)
_PADDING: Final = 3
"""Most padding bytes behind an object."""
_USUAL_BYTES: Final = 48
"""Usual size of an object, that of one with a classic frame."""
_LEAST_BYTES: Final = 16
_MOST_PACKED: Final = 1032 // _LEAST_BYTES
"""Most objects per byte of a file: zlib packs at most 1032 bytes into one."""


class Blf(ObjectReader):
    """Reader of one BLF file."""

    def blocks(self) -> Iterator[Block]:
        """See `ObjectReader.blocks`."""
        self._reset()
        held: list[Frame] = []
        for item in self._items():
            if isinstance(item, Frame):
                held.append(item)
                if len(held) < BLOCK:
                    continue
            if held:
                yield self._held(held)
            if isinstance(item, Block):
                self._count(item)
                yield item
        if held:
            yield self._held(held)
        self._end()

    def _reset(self) -> None:
        super()._reset()
        self._start_ns = self._promised_bytes = self._promised_objects = 0
        self._holes = self._lost_bytes = self._object_bytes = 0
        self._containers_read = self._restore_points = 0
        self._packed_bytes = self._unpacked_bytes = 0
        self._synchronised = True

    def _held(self, held: list[Frame]) -> Block:
        block = block_of(held)
        held.clear()
        self._count(block)
        return block

    def _items(self) -> Iterator[Frame | Block]:
        """Yield frames, and runs of them as blocks. Raises LogError if the file is not a BLF."""
        rest = b""
        with ExitStack() as stack:
            stream = self._open(stack)
            self._header(stream)
            for data in self._contents(stream):
                if data is not None:
                    rest = yield from self._objects(rest + data)
                    continue
                self._lost_bytes += len((yield from self._unfinished(rest)))
                rest, self._synchronised = b"", False
            rest = yield from self._unfinished(rest)
        if rest.strip(b"\0"):
            self.truncated = self.truncated or "in the middle of an object"
        elif self.bytes_read < self._promised_bytes:
            found = f"{self.bytes_read} of {self._promised_bytes} bytes"
            self.truncated = self.truncated or found

    def _header(self, stream: IO[bytes]) -> None:
        """Read the file's header: start time, expected size and expected number of objects."""
        head = self._read(stream, layout.FILE.size)
        if len(head) < layout.FILE.size or head[:4] != b"LOGG":
            raise LogError(self.name, 0, "cannot be read: not a BLF (it does not begin with LOGG)")
        fields = layout.FILE.unpack(head)
        self._read(stream, max(min(fields[1], _SEARCH) - layout.FILE.size, 0))
        self._start_ns = _system_time_ns(fields[14:22])
        if not self._start_ns:
            self.notes.append("the file has no start time: its times count from 0")
        self._promised_bytes, self._promised_objects = fields[10], fields[12]

    def _read(self, stream: IO[bytes], size: int) -> bytes:
        try:
            data = stream.read(size)
        except (EOFError, OSError, zlib.error) as error:  # raised by gzip
            if not self.zipped:
                raise
            self.truncated = f"compressed data end early or are damaged ({error})"
            return b""
        self.bytes_read += len(data)
        return data

    # ---- the file: containers, and objects that stand outside of them ------------------------

    def _contents(self, stream: IO[bytes]) -> Iterator[bytes | None]:
        """Yield the bytes of objects, and None where bytes are missing."""
        head = self._read(stream, layout.BASE.size)
        while head:
            if len(head) < layout.BASE.size:
                if head.strip(b"\0"):
                    self.truncated = "in the middle of a container's header"
                return
            signature, _, _, size, kind = layout.BASE.unpack(head)
            if signature != layout.SIGNATURE or not layout.BASE.size <= size <= layout.MOST_BYTES:
                if head.strip(b"\0"):
                    yield from self._resume(stream)
                head = self._read(stream, layout.BASE.size)
                continue
            body = self._read(stream, size - layout.BASE.size)
            is_cut = len(body) < size - layout.BASE.size
            if is_cut:
                self.truncated = "in the middle of a container"
            padding = self._read(stream, size % 4)
            this, head = head, self._read(stream, layout.BASE.size)
            followed = not is_cut and layout.is_followed(padding + head, len(padding))
            if not followed and (at := layout.find_container(body)) >= 0:
                self._lose(f"an object of {size} bytes contains another object")
                yield from self._go_back(stream, len(body) - at + len(padding + head), at)
                head = self._read(stream, layout.BASE.size)
            elif kind == layout.CONTAINER_KIND:
                self._containers_read += 1
                yield from self._unpacked(body, is_cut=is_cut)
            elif followed or is_cut:
                yield this + body + bytes(-size % 4)
            else:
                self._lose("an object that is not followed by another", size)
                yield None

    def _go_back(self, stream: IO[bytes], back: int, packed: int) -> Iterator[None]:
        """Go back by `back` bytes, to the end of a hole of `packed` bytes of the file."""
        stream.seek(-back, 1)
        self.bytes_read -= back
        self._lost_bytes += self._when_unpacked(packed)
        self.truncated = ""
        yield None

    def _resume(self, stream: IO[bytes]) -> Iterator[None]:
        """Go from an invalid object header to the next object, or to the end of the file."""
        at, back = self.bytes_read - layout.BASE.size, layout.BASE.size + _PADDING
        stream.seek(-back, 1)
        self.bytes_read -= back
        window, first, skipped = b"", True, 0
        while piece := self._read(stream, _SEARCH):
            window += piece
            found = layout.find_object(window, 0)
            if found >= 0:
                stream.seek(found - len(window), 1)
                self.bytes_read += found - len(window)
                if first and found <= 2 * _PADDING:  # padded in another way
                    return
                skipped += found
                break
            kept = min(len(window), layout.BASE.size - 1)
            skipped += len(window) - kept
            window, first = window[-kept:], False
        self._lose(f"no object at byte {at}", self._when_unpacked(skipped))
        yield None

    def _unpacked(self, body: bytes, *, is_cut: bool) -> Iterator[bytes | None]:
        """Yield the content of a container if it is intact or the file ends in it; None if lost."""
        if len(body) < layout.CONTAINER.size:
            return
        method, declared = layout.CONTAINER.unpack_from(body)
        data = body[layout.CONTAINER.size :]
        packed, size, why = len(data), min(declared, layout.MOST_BYTES), ""
        if method == 2:
            unpack = zlib.decompressobj()
            try:
                data = unpack.decompress(data, layout.MOST_BYTES)
            except zlib.error as error:
                why = f"a container is damaged ({error})"
            else:
                why = "" if unpack.eof or is_cut else "a container is damaged (it ends early)"
        elif method:
            why = f"a container of unknown compression {method}"
        if not why:
            yield data
            self._packed_bytes += packed
            self._unpacked_bytes += len(data)
            if is_cut or not len(data) < declared <= layout.MOST_BYTES:
                return
            why = f"a container has {len(data)} of {declared} bytes"
            size -= len(data)
        self._lose(why, size or self._when_unpacked(packed))
        yield None

    def _when_unpacked(self, packed: int) -> int:
        """Unpacked size of `packed` bytes of the file, estimated from the containers so far."""
        return packed * self._unpacked_bytes // max(self._packed_bytes, 1) or packed

    # ---- objects ------------------------------------------------------------------------------

    def _objects(self, data: bytes) -> Generator[Frame | Block, None, bytes]:
        """Yield the frames of complete objects; return the remaining bytes."""
        at = 0 if self._synchronised else self._skip_to_object(data, 0)
        following = data.find(layout.SIGNATURE, at, at + 8)
        while True:
            if following < 0:
                if len(data) - at < 8 or not data[at:].strip(b"\0"):
                    return data[at:].lstrip(b"\0")
                self._lose("bytes between objects")
                following = at = self._skip_to_object(data, at)
            at = following
            if at + layout.BASE.size > len(data):
                return data[at:]
            _, header, version, size, kind = layout.BASE.unpack_from(data, at)
            end = at + size
            if size < layout.BASE.size or size > layout.MOST_OF.get(kind, layout.MOST_BYTES):
                self._lose(f"an object of {size} bytes")
                following = at = self._skip_to_object(data, at, 4)
                continue
            if end > len(data):
                return data[at:]
            if kind in layout.MESSAGES and (objects := layout.run_of(data, at, size)) is not None:
                yield from self._run(objects)
                at += size * len(objects)
                following = data.find(layout.SIGNATURE, at, at + 8)
                continue
            following = data.find(layout.SIGNATURE, end, end + 8)
            if following < 0 and not layout.is_followed(data, end):
                self._lose("an object that is not followed by another")
                following = at = self._skip_to_object(data, at, 4)
                continue
            found = self._one(data[at:end], (header, version, size, kind))
            if found is not None:
                yield found
            at = end

    def _run(self, objects: NDArray[np.void]) -> Iterator[Block]:
        """Yield the frames of a run of objects, if there are any."""
        block = layout.frames_of_run(objects, self._start_ns)
        self._object_bytes += objects.nbytes
        if block.size < len(objects):
            self._skip(Verdict.REQUEST, len(objects) - block.size)
        if block.size:
            yield block

    def _one(self, data: bytes, fields: tuple[int, int, int, int]) -> Frame | None:
        """The frame of an object, if it has one."""
        self._object_bytes += len(data)
        try:
            found = layout.frame_of(data, fields, self._start_ns)
        except (struct.error, IndexError):
            found = f"an object of kind {fields[3]} that is too short"
        if isinstance(found, Frame):
            return found
        self._restore_points += fields[3] == layout.RESTORE_POINT_KIND
        if isinstance(found, str):
            self._skip_fault(Verdict.MALFORMED, found)
        elif found.is_fault:
            self._skip_fault(found, f"an object of kind {fields[3]} that is no frame")
        else:
            self._skip(found)
        return None

    # ---- what is lost -------------------------------------------------------------------------

    def _lose(self, text: str, size: int = 0) -> None:
        """Count a hole of `size` bytes. Its number of objects is estimated at the end."""
        self._holes += 1
        self._lost_bytes += size
        self._skip_fault(Verdict.MALFORMED, text)

    def _skip_to_object(self, data: bytes, at: int, least: int = 0) -> int:
        """Position of the next object, at least `least` bytes on; the end of the data if none."""
        found = layout.find_object(data, at + least)
        self._synchronised = found >= 0
        end = found if found >= 0 else len(data)
        self._lost_bytes += end - at
        return end

    def _unfinished(self, rest: bytes) -> Generator[Frame | Block, None, bytes]:
        """Yield the objects inside one whose size is damaged; return the remaining bytes."""
        while (at := layout.find_object(rest, len(layout.SIGNATURE))) >= 0:
            self._lose("an object that does not end", at)
            rest = yield from self._objects(rest[at:])
        return rest

    def _end(self) -> None:
        """Count the lost objects, by the header's count if that is plausible."""
        read = self.lines - self._holes
        missing = self._missing(read)
        if self._holes:
            usual = self._object_bytes / read if read else _USUAL_BYTES
            lost = round(self._lost_bytes / max(usual, 1))
            if missing is not None:
                lost = min(lost, missing - 1) if self.truncated else missing
            lost = max(lost, 1)
            self._skip(Verdict.MALFORMED, lost - self._holes)
            missing = None if missing is None else missing - lost
        if self.truncated and missing is not None and missing > 0:
            self.truncated += f"; {missing} of {self._promised_objects} objects are missing"
            self._skip(Verdict.CUT, missing - 1)
        elif missing and not self._holes:
            usual_counts = (self._restore_points, self._containers_read)
            if missing not in (*usual_counts, sum(usual_counts)):
                self.notes.append(
                    f"the file's header says {self._promised_objects} objects; it has {read}"
                )
        super()._end()

    def _missing(self, read: int) -> int | None:
        """Number of objects missing from the header's count; None if that is not plausible.

        Some writers leave the count at 0, and some count differently.
        """
        missing = self._promised_objects - (read - self._restore_points)
        bytes_left = max(self._promised_bytes - self.bytes_read, 0)
        most = max(self._lost_bytes // _LEAST_BYTES, read) + bytes_left * _MOST_PACKED
        is_likely = self._promised_objects and 0 <= missing <= most + self._holes
        return missing if is_likely else None


def _system_time_ns(fields: tuple[int, ...]) -> int:
    """Nanoseconds of a Windows SYSTEMTIME; 0 if invalid, or 1601, of a recorder without a clock."""
    year, month, _, day, hour, minute, second, ms = fields
    if year not in _YEARS:
        return 0
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0
    return round(moment.timestamp()) * SECOND + ms * 1_000_000
