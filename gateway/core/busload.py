"""Share of the bus in use: the records that `gateway/core/busload.c` keeps."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from _traction_core import ffi, lib

from dbc.frame import FD, Frame, Nanos
from dbc.frames import Block
from dbc.records import BUS_LOAD, Addressed
from dbc.wire_time import longest_seconds
from gateway.core.receiving import Receiver


class BusLoad(Addressed):
    """Load of one bus; bitrate, data_bitrate: nominal and data bit rate, bit/s."""

    def __init__(self, bitrate: int, data_bitrate: int, start_ns: Nanos) -> None:
        self.record = np.zeros(1, BUS_LOAD)
        lengths = range(lib.DATA_LENGTHS)
        self.record["classic_s"] = [longest_seconds(n, bitrate) for n in lengths]
        self.record["fd_s"] = [longest_seconds(n, bitrate, data_bitrate) for n in lengths]
        self.record["since_ns"], self.record["percent"] = start_ns, math.nan
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        self.pointer = ffi.from_buffer("struct bus_load *", self.record)

    def count(self, frames: Iterable[Frame]) -> None:
        """Count frames that are sent in this tick."""
        for frame in frames:
            lib.bus_load_send(self.pointer, frame[3] & FD, len(frame[2]))

    def add_block(self, block: Block, receiver: Receiver | None, now: Nanos) -> None:
        """Count frames received in a tick, except the gateway's own; receiver None: count all."""
        lib.bus_load_tick(self.pointer, now)
        lib.bus_load_receive(
            self.pointer, ffi.NULL if receiver is None else receiver.pointer, block.columns(), 0,
            block.size,
        )  # fmt: skip

    def percent(self, now: Nanos) -> float | None:
        """Load in the last closed window; None before the first, or 2 s after its end."""
        percent = lib.bus_load_percent(self.pointer, now)
        return None if math.isnan(percent) else percent
