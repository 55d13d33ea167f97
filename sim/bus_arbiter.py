"""A CAN bus as its receivers see it: one frame at a time, lowest identifier first.

A frame's stamp is the end of its transmission, as a controller stamps it. Each identifier has one
mailbox: a frame not yet sent when its successor comes is overwritten, as in a real controller.

May know: frames. May not know: what is in them.
"""

from __future__ import annotations

import heapq

from dbc.frame import FD, SECOND, Frame, Nanos


def bits(length: int) -> int:
    """Bits of a classic data frame with 11-bit identifier, half of the worst-case stuffing."""
    return 47 + 8 * length + (33 + 8 * length) // 8


def duration_ns(length: int, flags: int, bitrate: int, data_bitrate: int) -> Nanos:
    """Time a data frame holds the bus. FD: 30 bits at the nominal, the rest at the data rate."""
    if not flags & FD:
        return bits(length) * SECOND // bitrate
    data = 8 * length + 36
    return 30 * SECOND // bitrate + (data + data // 8) * SECOND // data_bitrate


class Arbiter:
    """Orders the frames of several nodes. Deterministic: the same offers give the same stamps."""

    def __init__(self, bitrate: int, data_bitrate: int) -> None:
        """`bitrate` 0: a bus without bit rate, frames arrive when they are offered."""
        self._bitrate, self._data_bitrate = bitrate, data_bitrate
        self._coming: list[tuple[Nanos, int, int, Frame]] = []
        self._count = 0
        self._waiting: dict[int, Frame] = {}
        self._sending: Frame | None = None
        self._free_ns: Nanos = 0

    def offer(self, frames: list[Frame]) -> None:
        """Offer frames, in any order; their `t_ns` is the time at which they are ready."""
        for frame in frames:
            self._count += 1
            heapq.heappush(self._coming, (frame.t_ns, frame.can_id, self._count, frame))

    def drain(self, until_ns: Nanos) -> list[Frame]:
        """Frames whose transmission ends at or before `until_ns`, stamped, in order."""
        out: list[Frame] = []
        coming, waiting = self._coming, self._waiting
        if not self._bitrate:
            while coming and coming[0][0] <= until_ns:
                out.append(heapq.heappop(coming)[3])
            return out
        while True:
            if self._sending is None:
                start = self._free_ns
                if not waiting:
                    if not coming:
                        break
                    start = max(start, coming[0][0])
                if start > until_ns:
                    break
                while coming and coming[0][0] <= start:
                    frame = heapq.heappop(coming)[3]
                    waiting[frame.can_id] = frame
                frame = waiting.pop(min(waiting))
                took = duration_ns(len(frame.data), frame.flags, self._bitrate, self._data_bitrate)
                self._free_ns = start + took
                self._sending = frame._replace(t_ns=self._free_ns)
            if self._free_ns > until_ns:
                break
            out.append(self._sending)
            self._sending = None
        return out
