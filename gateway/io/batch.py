"""Many frames by one system call: `recvmmsg`, with each frame's stamp and the drop counter.

Buffers are allocated once; received frames are copied into a fresh block.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any, Final

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.frame import Nanos
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.records import SOCKET_MESSAGE, SOCKET_VECTOR, pointer
from gateway.io.wire import FD_SIZE

CONTROL_SIZE: Final = 128
"""Bytes of control data per message; stamp and drop counter take 56 with 64-bit words."""
_DONTWAIT: Final = 0x40


class Batch:
    """Buffers for messages: `read_from` appends, `to_block` empties (`dbc/socketcan.c`).

    The kernel fills `data`, `control` and the header fields `control_sizes`, `sizes` and `flags`.
    """

    def __init__(self, capacity: int) -> None:
        """capacity: most messages between two calls of `to_block`."""
        self.capacity = capacity
        self.filled = 0
        self._counts: Any = ffi.new("struct socket_counts *")
        self._clock: Any = ffi.new("struct socket_clock *")
        self._rows: Any = ffi.new("struct frame_columns *")
        self.data = np.zeros((capacity, FD_SIZE), dtype=np.uint8)
        self.control = np.zeros((capacity, CONTROL_SIZE), dtype=np.uint8)
        steps = np.arange(capacity, dtype=np.uint64)
        self._vectors = np.zeros(capacity, dtype=SOCKET_VECTOR)
        self._vectors["frame"] = self.data.ctypes.data + FD_SIZE * steps
        self._vectors["bytes"] = FD_SIZE
        self._messages = np.zeros(capacity, dtype=SOCKET_MESSAGE)
        head = self._messages["head"]
        head["vector"] = self._vectors.ctypes.data + SOCKET_VECTOR.itemsize * steps
        head["vectors"] = 1
        head["control"] = self.control.ctypes.data + CONTROL_SIZE * steps
        head["control_size"] = CONTROL_SIZE
        self.sizes: NDArray[np.uint32] = self._messages["size"]
        self.control_sizes: NDArray[np.uint64] = head["control_size"]
        self.flags: NDArray[np.int32] = head["flags"]
        # Kept, as looking up an array's address takes as long as the system call.
        self._first = self._messages.ctypes.data
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._call.argtypes = (
            ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        )  # fmt: skip
        self._pointer = pointer("struct socket_message", self._messages)

    @property
    def full(self) -> bool:
        """Whether nothing more can be read before `to_block`."""
        return self.filled == self.capacity

    def begin(self) -> None:
        """Start with a new socket, whose drop counter starts at 0."""
        self._counts.drops_seen = 0

    def read_from(self, descriptor: int) -> bool:
        """Read the waiting messages. OSError as from `recvmsg`; BlockingIOError if there are none.

        True if room is left: either no more messages are waiting, or an error ended the call and
        the kernel keeps it (`SO_ERROR`).
        """
        wanted = self.capacity - self.filled
        at = self._first + self.filled * SOCKET_MESSAGE.itemsize
        count = self._call(descriptor, at, wanted, _DONTWAIT, None)
        if count < 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))
        self.filled += count
        return bool(count < wanted)

    def to_block(
        self, real_ns: Nanos, now_ns: Nanos, bound_ns: Nanos, name: str
    ) -> tuple[Block, int, int, int]:
        """Return the messages read as frames of interface `name`, and empty the buffers.

        real_ns, now_ns, bound_ns: as for `transport.monotonic_stamp`. Returns (block, number of
        messages that were no frames, of error frames, of frames that the kernel has dropped since
        the last call).
        """
        n, counts, clock, rows = self.filled, self._counts, self._clock, self._rows
        block = Block(
            np.empty(n, np.int64), np.empty(n, np.uint32), np.empty(n, np.uint8),
            np.empty(n, np.uint8), np.empty((n, MAX_DATA_BYTES), np.uint8), np.empty(n, np.int8),
            np.empty(n, np.uint16), [name],
        )  # fmt: skip
        clock.real_ns, clock.now_ns, clock.max_age_ns = real_ns, now_ns, bound_ns
        rows.t_ns, rows.can_id = pointer("int64_t", block.t_ns), pointer("uint32_t", block.can_id)
        rows.flags, rows.length = pointer("uint8_t", block.flags), pointer("uint8_t", block.length)
        rows.data, rows.dlc = pointer("uint8_t", block.data), pointer("int8_t", block.dlc)
        rows.channel = pointer("uint16_t", block.channel)
        lib.unpack_frames(self._pointer, n, CONTROL_SIZE, clock, rows, counts)
        self.filled, malformed = 0, counts.malformed
        whole = block.part(0, counts.frames) if malformed else block
        return whole, malformed, counts.errors, counts.dropped
