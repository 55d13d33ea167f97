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

from dbc.block import Block, blank
from dbc.frame import Nanos
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
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg
        # Compiled, or loaded, now and not in the first tick.
        self.take(0, 0, 0, "")

    @property
    def full(self) -> bool:
        """Nothing more can be read before `take`."""
        return self.filled == self.room

    def begin(self) -> None:
        """A new socket: its drop counter starts at 0."""
        self._tally[compiled.LAST_DROPS] = 0

    def read(self, descriptor: int) -> None:
        """Read what waits. OSError as `recvmsg` raises it; BlockingIOError if nothing waits."""
        at = self._messages.ctypes.data + self.filled * _MESSAGE.itemsize
        count = self._call(
            descriptor, ctypes.c_void_p(at), self.room - self.filled, _DONTWAIT, None
        )
        if count < 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))
        self.filled += count

    def take(
        self, real_ns: Nanos, now_ns: Nanos, bound_ns: Nanos, name: str
    ) -> tuple[Block, int, int, int]:
        """What was read, as frames of interface `name`, and room for more.

        real_ns, now_ns, bound_ns: as for `transport.monotonic_stamp`. With the block come the
        numbers of messages that were no frames, of error frames, and of frames that the kernel has
        dropped meanwhile.
        """
        n = self.filled
        block = blank(n, [name])
        tally = self._tally
        tally[compiled.DROPPED] = 0
        compiled.unpack_rows(
            self.data, self.sizes, self.flags, self.control, self.control_sizes, n, NATIVE,
            block.t_ns, block.can_id, block.flags, block.length, block.data, block.dlc,
            tally,
        )  # fmt: skip
        frames, malformed, errors, dropped, _ = tally.tolist()
        compiled.age_rows(block.t_ns, frames, real_ns, now_ns, bound_ns)
        self.filled = 0
        return block.part(0, frames) if malformed else block, malformed, errors, dropped
