"""Read the temperatures of a log, cycle by cycle, without the other stations of a tick.

A log of slow messages takes only the time for its frames: no filter or detector runs, and no frame
is sent.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib

from dbc.arrays import Array, Flags, Ints
from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from dbc.frames import Block, block_of
from dbc.records import TEMPERATURE_LOG, Addressed, point_to, pointer
from gateway.core.gateway import Gateway
from gateway.core.thermal import TemperatureMonitor
from gateway.settings.calibration import POINTS
from gateway.settings.config import Config

CYCLES: Final = 4096
"""Number of temperature cycles for which there is room."""


class Cycles(NamedTuple):
    """R temperature cycles of N motors, P points and Q quantities of a second (`thermal_quantity`).

    value_c, mean_c: (R, N, P) degC, last readings and window averages; known: (R, N, P), whether
    the average is known; held_ns: (R, N, P) time since the reading changed; second: (R, N, Q)
    means of a second, valid where `second_complete` (R,).
    """

    second_complete: Flags
    value_c: Array
    mean_c: Array
    known: Flags
    held_ns: Ints
    second: Array


class CycleLog(Addressed):
    """Store of cycles (`struct temperature_log`) until they are read."""

    def __init__(self, motors: int, capacity: int = CYCLES) -> None:
        """Make room for `capacity` cycles."""
        shape = (capacity, motors, len(POINTS))
        self._columns = Cycles(
            np.zeros(capacity, np.bool_), np.zeros(shape), np.zeros(shape),
            np.zeros(shape, np.bool_), np.zeros(shape, np.int64),
            np.zeros((capacity, motors, lib.THERMAL_QUANTITIES)),
        )  # fmt: skip
        self.record = np.zeros(1, TEMPERATURE_LOG)
        self.record["capacity"] = capacity
        self.link()

    def link(self) -> None:
        """Set the addresses of the columns, see `Addressed`."""
        point_to(self.record, self._columns._asdict())
        self.pointer: Any = ffi.from_buffer("struct temperature_log *", self.record)

    @property
    def full(self) -> bool:
        """Whether there is no room for another cycle."""
        return bool(self.pointer.count == self.pointer.capacity)

    def note(self, side: TemperatureMonitor, now: Nanos) -> None:
        """Store the monitor's last cycle, unless it is stored already. There must be room."""
        lib.note_temperature_cycle(self.pointer, side.pointer, now)

    def drain(self) -> Cycles:
        """Return and remove the cycles stored since the last call."""
        count = int(self.pointer.count)
        self.pointer.count = 0
        return Cycles._make(column[:count].copy() for column in self._columns)


class TemperatureReader(Gateway):
    """Gateway whose ticks only read temperatures and the other quantities for thermal models."""

    def __init__(self, config: Config, codec: Codec, start_ns: Nanos) -> None:
        """As `Gateway`. `log` gets the cycles of the ticks; the caller reads it when it is full."""
        super().__init__(config, codec, start_ns)
        self.log = CycleLog(len(self.nodes))

    def step(self, frames: Iterable[Frame] | Block, now: Nanos) -> list[Frame]:
        """Run one tick; no frame is sent."""
        block = frames if isinstance(frames, Block) else block_of(frames)
        self.run(block, np.array([block.size]), now)
        return []

    def run(self, block: Block, ends: Ints, now: Nanos) -> tuple[int, list[Block]]:
        """Run ticks as `Gateway.run` does; stop when the log is full."""
        period_ns = self.config.loop.period_ns
        block = block.part(0, int(ends[-1]))
        if self.translator is not None:
            last = now + (len(ends) - 1) * period_ns
            block = self.translator.translate(block, last, self.inbox.added)
        block = block.ordered()
        nows = now + period_ns * np.arange(len(ends))
        ends = np.searchsorted(block.t_ns, nows, "right").astype(np.int64)
        most = int(np.diff(ends, prepend=0).max())
        if most > self._capacity:
            self._reserve(most)
        done: int = lib.run_temperatures(
            self.pointer, self.log.pointer, block.columns(), pointer("int64_t", ends), len(ends),
            now,
        )  # fmt: skip
        self._now = now + (done - 1) * period_ns
        return done, []

    @property
    def changed(self) -> bool:
        """Whether the log is full and must be read."""
        return self.log.full

    @property
    def says_good(self) -> bool:
        """Whether any message is still fresh: a gap in a log is skipped once none is."""
        channels = self.inbox.receiver.channels
        age = self._now - channels["accepted_ns"]
        return bool(((channels["accepted_ns"] >= 0) & (age <= channels["limit_ns"])).any())
