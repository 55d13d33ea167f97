"""Share of the bus in use, worst-case stuffing, over the last full second."""

from __future__ import annotations

from collections.abc import Iterable

from dbc.frame import FD, SECOND, Frame, Nanos


class BusLoad:
    """Counts frames of one bus; nominal and data bit rate in bit/s."""

    def __init__(self, bitrate: int, data_bitrate: int, start_ns: Nanos) -> None:
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.classic_s = [(47 + 8 * n + (33 + 8 * n) // 4) / bitrate for n in range(16)]
        self.since_ns = start_ns
        self.busy_s = 0.0
        self.last: float | None = None

    def add(self, frames: Iterable[Frame], now: Nanos) -> None:
        """Count frames of one tick; a window closes every second."""
        if now - self.since_ns >= SECOND:
            self.last = min(126.0, 100.0 * self.busy_s * SECOND / (now - self.since_ns))
            self.since_ns = now
            self.busy_s = 0.0
        classic = self.classic_s
        for frame in frames:
            if frame[3] & FD:
                n = len(frame[2])
                self.busy_s += 34 / self.bitrate + (8 * n + 33 + 8 * n // 4) / self.data_bitrate
            else:
                self.busy_s += classic[len(frame[2]) & 15]

    def percent(self, now: Nanos) -> float | None:
        """The last closed window; None before the first, or when it is long past."""
        return self.last if now - self.since_ns <= 2 * SECOND else None
