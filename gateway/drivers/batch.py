"""Many frames by one system call: `recvmmsg`, with each frame's stamp and the drop counter.

Buffers are made once; what is read is copied into a fresh block.
"""

from __future__ import annotations

import ctypes
import os
import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.block import ROOM, Block
from dbc.frame import Nanos
from gateway._direct import Direct
from gateway.drivers import _batch_kernels as compiled
from gateway.drivers.wire import FD_SIZE

CONTROL_SIZE: Final = 128
"""Stamp and drop counter take 56 bytes with 64-bit words."""
NATIVE: Final = struct.calcsize("@l")
_DONTWAIT: Final = 0x40

_IOVEC: Final = np.dtype([("base", np.uintp), ("size", np.uintp)])
_HEAD: Final = np.dtype(
    [
        ("name", np.uintp),
        ("name_size", np.uint32),
        ("vector", np.uintp),
        ("vectors", np.uintp),
        ("control", np.uintp),
        ("control_size", np.uintp),
        ("flags", np.int32),
    ],
    align=True,
)
_MESSAGE: Final = np.dtype([("head", _HEAD), ("size", np.uint32)], align=True)
"""`struct msghdr` and `struct mmsghdr` of recvmsg(2) and recvmmsg(2)."""


class Batch:
    """Room for so many messages; `read` fills on, `take` empties.

    data, control and what is seen of the headers (control_sizes, sizes, flags) the kernel fills.
    """

    def __init__(self, room: int) -> None:
        """room: messages."""
        self.room = room
        self.filled = 0
        self._tally = np.zeros(5, dtype=np.int64)
        self.data = np.zeros((room, FD_SIZE), dtype=np.uint8)
        self.control = np.zeros((room, CONTROL_SIZE), dtype=np.uint8)
        steps = np.arange(room, dtype=np.uint64)
        self._vectors = np.zeros(room, dtype=_IOVEC)
        self._vectors["base"] = self.data.ctypes.data + FD_SIZE * steps
        self._vectors["size"] = FD_SIZE
        self._messages = np.zeros(room, dtype=_MESSAGE)
        head = self._messages["head"]
        head["vector"] = self._vectors.ctypes.data + _IOVEC.itemsize * steps
        head["vectors"] = 1
        head["control"] = self.control.ctypes.data + CONTROL_SIZE * steps
        head["control_size"] = CONTROL_SIZE
        self.sizes: NDArray[np.uint32] = self._messages["size"]
        self.control_sizes: NDArray[np.uint64] = head["control_size"]
        self.flags: NDArray[np.int32] = head["flags"]
        # To look an address up takes as long as the system call.
        self._first = self._messages.ctypes.data
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._call.argtypes = (
            ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        )  # fmt: skip
        self._unpack = Direct(compiled.unpack_rows)
        # Compiled, or loaded, now and not in the first tick.
        self.take(0, 0, 0, "")

    @property
    def full(self) -> bool:
        """Nothing more can be read before `take`."""
        return self.filled == self.room

    def begin(self) -> None:
        """A new socket: its drop counter starts at 0."""
        self._tally[compiled.LAST_DROPS] = 0

    def read(self, descriptor: int) -> bool:
        """Read what waits. OSError as `recvmsg` raises it; BlockingIOError if nothing waits.

        True if there is room left: nothing waits any more, or there was an error, which the kernel
        then keeps (`SO_ERROR`).
        """
        wanted = self.room - self.filled
        at = self._first + self.filled * _MESSAGE.itemsize
        count = self._call(descriptor, at, wanted, _DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))
        self.filled += count
        return bool(count < wanted)

    def take(
        self, real_ns: Nanos, now_ns: Nanos, bound_ns: Nanos, name: str
    ) -> tuple[Block, int, int, int]:
        """What was read, as frames of interface `name`, and room for more.

        real_ns, now_ns, bound_ns: as for `transport.monotonic_stamp`. With the block come the
        numbers of messages that were no frames, of error frames, and of frames that the kernel has
        dropped meanwhile.
        """
        n, tally = self.filled, self._tally
        block = Block(
            np.empty(n, np.int64), np.empty(n, np.uint32), np.empty(n, np.uint8),
            np.empty(n, np.uint8), np.empty((n, ROOM), np.uint8), np.empty(n, np.int8),
            np.empty(n, np.uint16), [name],
        )  # fmt: skip
        self._unpack(
            self.data, self.sizes, self.flags, self.control, self.control_sizes, n, NATIVE,
            block.t_ns, block.can_id, block.flags, block.length, block.data, block.dlc,
            block.channel, tally, real_ns, now_ns, bound_ns,
        )  # fmt: skip
        frames, malformed, errors, dropped, _ = tally.tolist()
        self.filled = 0
        return block.part(0, frames) if malformed else block, malformed, errors, dropped
