"""Frames as SocketCAN's C structures, and the bus state in error frames. No socket, no clock.

The reverse, C structures to frames, is `unpack_frames` in `dbc/socketcan.c`.

Layout of `struct can_frame` (16 bytes) and `struct canfd_frame` (72 bytes): linux/can.h;
error classes: linux/can/error.h.
"""

from __future__ import annotations

import struct
from enum import StrEnum

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame

FD_SIZE = 72

_HEAD = struct.Struct("=IBBBB")  # id and flags, length, FD flags, reserved, raw length 9..15
_EFF, _RTR = 0x8000_0000, 0x4000_0000
_SFF_MASK, _EFF_MASK = 0x7FF, 0x1FFF_FFFF
_FD_BRS, _FD_ESI = 1, 2


class BusState(StrEnum):
    """Fault confinement state of the controller, as error frames report it."""

    ACTIVE = "active"
    WARNING = "warning"
    PASSIVE = "passive"
    BUS_OFF = "bus-off"


def pack(frame: Frame) -> bytes | None:
    """The bytes that a raw CAN socket takes for a frame; None if no CAN bus could carry it."""
    length = len(frame.data)
    extended = frame.flags & EXTENDED
    can_id = frame.can_id
    if frame.flags & ERROR or not 0 <= can_id <= (_EFF_MASK if extended else _SFF_MASK):
        return None
    if extended:
        can_id |= _EFF
    if frame.flags & FD:
        if length not in FD_LENGTHS or frame.flags & REMOTE:
            return None
        # CANFD_FDF (4) is not set: the size of the structure implies it, as in cansend.
        flags = _FD_BRS if frame.flags & BRS else 0
        flags |= _FD_ESI if frame.flags & ESI else 0
        return _HEAD.pack(can_id, length, flags, 0, 0) + frame.data.ljust(64, b"\0")
    if length > 8:
        return None
    raw = frame.dlc if length == 8 and 9 <= frame.dlc <= 15 else 0
    if frame.flags & REMOTE:
        can_id |= _RTR
        raw = frame.dlc if 9 <= frame.dlc <= 15 else 0
        length = min(max(frame.dlc, 0), 8)
        return _HEAD.pack(can_id, length, 0, 0, raw) + bytes(8)
    return _HEAD.pack(can_id, length, 0, 0, raw) + frame.data.ljust(8, b"\0")


_CLASS_CONTROLLER, _CLASS_BUS_OFF, _CLASS_RESTARTED = 0x004, 0x040, 0x100


def bus_state(error: Frame, before: BusState) -> BusState:
    """Controller state after an error frame; `before` if the frame does not report the state."""
    if error.can_id & _CLASS_BUS_OFF:
        return BusState.BUS_OFF
    if error.can_id & _CLASS_RESTARTED:
        return BusState.ACTIVE
    if error.can_id & _CLASS_CONTROLLER and len(error.data) > 1:
        detail = error.data[1]
        if detail & 0x30:
            return BusState.PASSIVE
        if detail & 0x0C:
            return BusState.WARNING
        if detail & 0x40:
            return BusState.ACTIVE
    return before
