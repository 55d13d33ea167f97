"""SocketCAN's C structures as frames, one at a time: the oracle of `dbc/socketcan.c`.

Layout of `struct can_frame` (16 bytes) and `struct canfd_frame` (72 bytes): linux/can.h.
"""

from __future__ import annotations

import struct

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame

CLASSIC_SIZE, FD_SIZE = 16, 72
_HEAD = struct.Struct("=IBBBB")  # id and flags, length, FD flags, reserved, raw length 9..15
_EFF, _RTR, _ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_SFF_MASK, _EFF_MASK = 0x7FF, 0x1FFF_FFFF
_FD_BRS, _FD_ESI = 1, 2


def unpack(buffer: bytes, t_ns: int, channel: str) -> Frame | None:
    """Bytes read from a raw CAN socket to a frame; None for anything but classic CAN and CAN FD."""
    size = len(buffer)
    if size not in (CLASSIC_SIZE, FD_SIZE):
        return None
    word, length, fd_flags, _, raw = _HEAD.unpack_from(buffer)
    flags = 0
    if size == FD_SIZE:
        flags = FD
        if fd_flags & _FD_BRS:
            flags |= BRS
        if fd_flags & _FD_ESI:
            flags |= ESI
    if word & _ERR:
        return Frame(t_ns, word & _EFF_MASK, buffer[8 : 8 + min(length, 8)], ERROR, channel)
    if word & _EFF:
        can_id = word & _EFF_MASK
        flags |= EXTENDED
    else:
        can_id = word & _SFF_MASK
    if size == FD_SIZE:
        return Frame(t_ns, can_id, buffer[8 : 8 + length], flags, channel)
    dlc = raw if length == 8 and 9 <= raw <= 15 else -1
    if word & _RTR:
        asked = dlc if dlc > 0 else min(length, 8) or -1  # a length byte says up to 255
        return Frame(t_ns, can_id, b"", flags | REMOTE, channel, asked)
    return Frame(t_ns, can_id, buffer[8 : 8 + length], flags, channel, dlc)
