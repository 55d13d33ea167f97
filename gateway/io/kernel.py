"""The system calls of the SocketCAN transport, in one place; tests replace them."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import time
from typing import NamedTuple

from dbc.frame import Nanos
from gateway.io.batch import Batch

RECEIVE_BUFFER = 8 << 20

_SO_RCVBUFFORCE, _SO_TIMESTAMPNS, _SO_RXQ_OVFL, _SO_MEMINFO = 33, 35, 40, 55
_MEMINFO = struct.Struct("=8xI")
"""Picks `SK_MEMINFO_WMEM_ALLOC` of linux/sock_diag.h."""
_FIRST_BAND = 6
"""Highest priority without privilege: ahead of other programs' frames in the kernel's queue."""
_CAN_RAW_ERR_FILTER = 2
_SIOCGIFFLAGS, _SIOCGIFMTU, _SIOCGIFINDEX = 0x8913, 0x8921, 0x8933
_IFF_UP = 1
_IFREQ = struct.Struct("16s24x")


class Link(NamedTuple):
    """Index, state and MTU of an interface, as the kernel reports them."""

    ifindex: int
    up: bool
    mtu: int


class Kernel:
    """The system calls, in one place; tests pass a stand-in."""

    def monotonic_ns(self) -> Nanos:
        """CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def real_ns(self) -> Nanos:
        """CLOCK_REALTIME, the clock of the kernel's stamps."""
        return time.time_ns()

    def connect(self, channel: str, fd: bool, first: bool = False) -> socket.socket:
        """A bound, non-blocking raw CAN socket. Raises OSError.

        first: its frames go ahead of those of other programs in the kernel's queue.
        """
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            raw.setblocking(False)
            raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            raw.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, socket.CAN_ERR_MASK)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(fd))
            if first:
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, _FIRST_BAND)
            try:
                raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER)
            except OSError:  # not root: as much as net.core.rmem_max allows
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            raw.bind((channel,))
        except OSError:
            raw.close()
            raise
        return raw

    def queued(self, raw: socket.socket) -> int:
        """Memory of this socket's frames that no driver has taken yet, bytes.

        0 if the kernel does not report it (before 4.12): frames then queue without a limit here.
        """
        try:
            found = raw.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            return int(_MEMINFO.unpack(found)[0])
        except (OSError, struct.error):
            return 0

    def look(self, raw: socket.socket, channel: str) -> Link | None:
        """Index, flags and MTU of an interface by name; None if there is none."""
        request = _IFREQ.pack(channel.encode()[:15])
        try:
            answers = [
                struct.unpack_from("=i", fcntl.ioctl(raw.fileno(), code, request), 16)[0]
                for code in (_SIOCGIFINDEX, _SIOCGIFFLAGS, _SIOCGIFMTU)
            ]
        except OSError:
            return None
        return Link(answers[0], bool(answers[1] & _IFF_UP), answers[2])

    def read(self, raw: socket.socket, batch: Batch) -> bool:
        """Read waiting frames; True if none is left. OSError, BlockingIOError as `Batch.read_from`.

        Asking for an error that ended the call early takes a quarter of the time of a second read.
        """
        if not batch.read_from(raw.fileno()):
            return False
        if code := raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise OSError(code, os.strerror(code))
        return True
