"""Frames as Vector's BLF, with times exact to the nanosecond."""

from __future__ import annotations

import struct
import zlib
from datetime import timedelta
from pathlib import Path
from typing import Final

import numpy as np

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame, Nanos
from dbc.frames import Block
from dbc.logs import blf_objects as layout
from dbc.logs.format import DLC_OF
from dbc.logs.times import EPOCH
from gateway.logfiles.channels import ChannelNumbers
from gateway.logfiles.frames import Sink, without

_HEADER_BYTES, _CONTAINER_BYTES, _MS = 144, 128 * 1024, 1_000_000
_STAMP: Final = struct.Struct("<LHHQ")
_NANOSECONDS, _LONG_ID, _REMOTE_FLAG = 2, 0x8000_0000, 0x80
_MESSAGE: Final = 1
_MOST_CHANNEL: Final = 0xFFFE
"""Highest channel number from 0; in the file, channels count from 1, in 16 bits."""
_LOBJ, _AT_ONCE = int.from_bytes(b"LOBJ", "little"), 2048


class BlfFile(Sink):
    """A BLF file. Its start time is that of the first frame, cut to milliseconds, in UTC."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._channels = ChannelNumbers(_MOST_CHANNEL)
        self._file = path.open("wb")
        self._file.write(bytes(_HEADER_BYTES))
        self._first_ns: Nanos | None = None
        self._start_ns = self._last_ns = self._unpacked = 0
        self._held = bytearray()

    def add(self, block: Block) -> None:
        """Append frames."""
        if not block.size:
            return
        if self._first_ns is None:
            self._first_ns = block.t_ns.item(0)
            self._start_ns = self._first_ns // _MS * _MS
        block = without(block, block.t_ns < self._first_ns, self.left_out, "before_the_first")
        self._last_ns = max(self._last_ns, int(block.t_ns.max(initial=0)))
        self.written += block.size
        lost = block.flags & (ERROR | TX) == ERROR | TX
        self.reduced["direction"] += int(np.count_nonzero(lost))
        self.reduced["channel"] += self._channels.lost(block)
        for first in range(0, block.size, _AT_ONCE):
            part = block.part(first, min(first + _AT_ONCE, block.size))
            if (part.flags & (ERROR | FD)).any():
                self._held += b"".join(map(self._object, part.frames()))
            else:
                self._held += self._classic(part)
            if len(self._held) >= _CONTAINER_BYTES:
                self._flush()

    def _classic(self, block: Block) -> bytes:
        """Objects of classic data and remote frames."""
        objects = np.zeros(block.size, layout.CLASSIC_FIELDS)
        objects["signature"], objects["header"], objects["version"] = _LOBJ, 32, 1
        objects["size"], objects["kind"] = objects.itemsize, _MESSAGE
        objects["flags"] = _NANOSECONDS
        objects["stamp"] = block.t_ns - self._start_ns
        numbers = np.array([self._channels.number(name) + 1 for name in block.names], np.uint16)
        objects["channel"] = numbers[block.channel]
        remote = block.flags & REMOTE != 0
        sent = block.flags & TX != 0
        objects["bits"] = np.where(remote, _REMOTE_FLAG, 0) | np.where(sent, layout.SENT_FLAG, 0)
        dlc = np.where(remote, block.dlc.clip(min=0), block.length)
        objects["dlc"] = np.where(~remote & (block.dlc >= 0), block.dlc, dlc)
        long = np.where(block.flags & EXTENDED, np.uint32(_LONG_ID), np.uint32(0))
        objects["can_id"] = block.can_id | long
        objects["data"] = block.data[:, :8]
        return objects.tobytes()

    def _object(self, frame: Frame) -> bytes:
        channel = self._channels.number(frame.channel) + 1
        flags, data = frame.flags, frame.data
        can_id = frame.can_id | (_LONG_ID if flags & EXTENDED else 0)
        sent = layout.SENT_FLAG if flags & TX else 0
        dlc = frame.dlc if frame.dlc >= 0 else len(data)
        if flags & ERROR:
            kind = layout.ERROR_EXT_KIND
            body = layout.ERROR_EXT.pack(channel, 0, 0, 0, 0, len(data), 0, can_id, 0, data)
        elif flags & FD:
            kind = layout.FD_KIND
            bits = 1 | (2 if flags & BRS else 0) | (4 if flags & ESI else 0)
            size = len(data)
            body = layout.FD_MESSAGE.pack(
                channel, sent, DLC_OF[size], can_id, 0, 0, bits, size, data
            )
        else:
            kind = _MESSAGE
            remote = _REMOTE_FLAG if flags & REMOTE else 0
            body = layout.CLASSIC.pack(channel, remote | sent, max(dlc, 0), can_id, data)
        size = layout.BASE.size + _STAMP.size + len(body)
        head = layout.BASE.pack(b"LOBJ", layout.BASE.size + _STAMP.size, 1, size, kind)
        stamp = _STAMP.pack(_NANOSECONDS, 0, 0, frame.t_ns - self._start_ns)
        return head + stamp + body + bytes(len(body) % 4)

    def _flush(self) -> None:
        if not self._held:
            return
        data, self._held = bytes(self._held), bytearray()
        body = layout.CONTAINER.pack(2, len(data)) + zlib.compress(data)
        size = layout.BASE.size + len(body)
        head = layout.BASE.pack(b"LOBJ", layout.BASE.size, 1, size, layout.CONTAINER_KIND)
        self._file.write(head + body + bytes(size % 4))
        self._unpacked += layout.BASE.size + layout.CONTAINER.size + len(data)

    def close(self) -> None:
        """Complete the file and close it."""
        self._flush()
        size = self._file.tell()
        self._file.seek(0)
        fields = (
            b"LOGG", _HEADER_BYTES, 5, 0, 0, 0, 2, 6, 8, 1, size, self._unpacked, self.written, 0,
        )  # fmt: skip
        times = (*_system_time(self._start_ns), *_system_time(self._last_ns))
        self._file.write(layout.FILE.pack(*fields, *times))
        self._file.close()


def _system_time(t_ns: Nanos) -> tuple[int, ...]:
    """Windows' SYSTEMTIME in UTC; zeros, which mean no time, up to 1970."""
    if t_ns <= 0:
        return (0,) * 8
    m = EPOCH + timedelta(microseconds=t_ns // 1000)
    day = m.isoweekday() % 7
    return (m.year, m.month, day, m.day, m.hour, m.minute, m.second, m.microsecond // 1000)
