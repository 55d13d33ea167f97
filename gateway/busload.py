"""Share of the bus in use, worst-case stuffing, over the last full second."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from _traction_core import ffi, lib

from dbc.block import Block
from dbc.frame import FD, SECOND, Frame, Nanos
from gateway.receiving import Receiver


class BusLoad:
    """Counts frames of one bus; nominal and data bit rate in bit/s."""

    def __init__(self, bitrate: int, data_bitrate: int, start_ns: Nanos) -> None:
        lengths = range(256)
        self.classic_s = np.array([(47 + 8 * n + (33 + 8 * n) // 4) / bitrate for n in lengths])
        self.fd_s = np.array(
            [34 / bitrate + (8 * n + 33 + 8 * n // 4) / data_bitrate for n in lengths]
        )
        """Seconds on the wire by number of data bytes."""
        self.since_ns = start_ns
        self.busy_s = 0.0
        self.last: float | None = None

    def add(self, frames: Iterable[Frame]) -> None:
        """Count frames that go out in this tick."""
        for frame in frames:
            self.busy_s += self.cost_s(frame)

    def close(self, now: Nanos) -> None:
        """Before a tick's frames: the window, every second."""
        if now - self.since_ns >= SECOND:
            self.last = min(126.0, 100.0 * self.busy_s * SECOND / (now - self.since_ns))
            self.since_ns = now
            self.busy_s = 0.0

    def add_block(self, block: Block, receiver: Receiver | None, now: Nanos) -> None:
        """Count what came in a tick but for the receiver's own; None: there are none."""
        self.close(now)
        self.busy_s = lib.bus_time(
            ffi.NULL if receiver is None else receiver.pointer, block.size,
            ffi.from_buffer("uint32_t[]", block.can_id),
            ffi.from_buffer("uint8_t[]", block.flags), ffi.from_buffer("uint8_t[]", block.length),
            ffi.from_buffer("double[]", self.classic_s), ffi.from_buffer("double[]", self.fd_s),
            self.busy_s,
        )  # fmt: skip

    @property
    def window_ns(self) -> Nanos:
        """From when on a tick closes the window."""
        return self.since_ns + SECOND

    def cost_s(self, frame: Frame) -> float:
        """Seconds that a frame takes on the wire."""
        return float((self.fd_s if frame[3] & FD else self.classic_s).item(len(frame[2])))

    def percent(self, now: Nanos) -> float | None:
        """The last closed window; None before the first, or when it is long past."""
        return self.last if now - self.since_ns <= 2 * SECOND else None
