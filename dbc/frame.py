"""The one frame type of the project: buses, logs and the simulator exchange it.

Time is an integer in nanoseconds on the clock of the source (monotonic when live, the log's own
when replaying). Frames are values: nothing here reads a clock.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from _traction_core import lib

Nanos = int
"""Integer nanoseconds. Floats lose 238 ns at today's epoch, so they never carry time here."""

EXTENDED: Final[int] = lib.FRAME_EXTENDED
REMOTE: Final[int] = lib.FRAME_REMOTE
ERROR: Final[int] = lib.FRAME_ERROR
FD: Final[int] = lib.FRAME_FD
BRS: Final[int] = lib.FRAME_BRS
ESI: Final[int] = lib.FRAME_ESI
TX: Final[int] = lib.FRAME_TX
"""Direction in a log: the recorder itself sent the frame. Not set: received, or not known."""

FD_LENGTHS: Final = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))
"""Data lengths of a CAN FD frame in bytes; `dbc/fd_length.h` has the same list for the core."""

MS: Nanos = 1_000_000
SECOND: Nanos = 1_000_000_000


class Frame(NamedTuple):
    """A CAN frame as seen on the wire.

    `can_id` is the bare identifier (11 or 29 bits; for error frames the error class bits,
    29 bits); `flags` are the constants above or-ed; `dlc` is -1 if it equals the data length,
    else the requested length of a remote frame or a raw classic DLC of 9..15.
    """

    t_ns: Nanos
    can_id: int
    data: bytes = b""
    flags: int = 0
    channel: str = ""
    dlc: int = -1

    @property
    def is_fd(self) -> bool:
        """True for a CAN FD frame."""
        return bool(self.flags & FD)

    @property
    def is_plain_data(self) -> bool:
        """True for an 11-bit data frame: the only kind the message set uses."""
        return not self.flags & (EXTENDED | REMOTE | ERROR)
