"""Reasons that make the flags of all drives unknown, from the driver's notes.

Missed ticks, lost frames, a second gateway. The rules are in `gateway/core/integrity.c`. May know:
reasons and `now`. May not know: frames, clocks. How long an intruder makes flags unknown is the
configuration's choice (docs/threats.md).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from _traction_core import ffi, lib

from dbc.frame import SECOND, Nanos
from dbc.records import INTEGRITY, Addressed
from gateway.core.codes import NEVER

OVERRUN_HOLD_NS: Final[Nanos] = SECOND
"""Time for which an overrun is reported."""
INTRUDER_HOLD_NS: Final[Nanos] = 10 * SECOND
"""With `on_intruder = "unknown"`: time for which flags stay unknown after an intruder."""
LOST_TICKS: Final = 5
"""Ticks with unknown flags after frames were lost unread, which may be of any drive."""
FOREVER: Final[Nanos] = (1 << 63) - 1


class IntegrityMonitor(Addressed):
    """Notes of the driver before a step, and the reasons that follow from them in a tick.

    record (1,): `struct integrity`.
    """

    def __init__(
        self,
        tick_ns: Nanos,
        *,
        authenticated: bool = False,
        intruder_hold_ns: Nanos | None = None,
        stops: bool = False,
    ) -> None:
        """tick_ns: period of the loop.

        authenticated: receivers recognise an intruder's frames, so ours are still good.
        intruder_hold_ns: flags are unknown for so long after the intruder's last frame; None: until
        restart. stops: nothing is sent any more after an intruder.
        """
        self.record = np.zeros(1, INTEGRITY)
        self.record["overrun_hold_ns"] = OVERRUN_HOLD_NS
        self.record["lost_hold_ns"] = LOST_TICKS * tick_ns
        hold = FOREVER if intruder_hold_ns is None else intruder_hold_ns
        self.record["intruder_hold_ns"] = hold
        self.record["authenticated"], self.record["stop_on_intruder"] = authenticated, stops
        for name in ("overrun_ns", "lost_ns", "intruder_ns"):
            self.record[name] = NEVER
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        self.pointer = ffi.from_buffer("struct integrity *", self.record)

    def note_overrun(self, missed: int) -> None:
        """Note that so many ticks were skipped before the next one."""
        self.pointer.missed_ticks = missed

    def note_lost(self, frames: int) -> None:
        """Note that so many frames were dropped unread since the last step."""
        self.pointer.lost_frames += frames

    @property
    def watching(self) -> bool:
        """Whether frames with our identifiers can only come from another sender."""
        return bool(self.pointer.watching)

    @watching.setter
    def watching(self, watched: bool) -> None:
        self.pointer.watching = watched

    @property
    def intruder(self) -> bool:
        """Whether another sender has used our identifiers. Latched."""
        return bool(self.pointer.intruder)

    @property
    def silent(self) -> bool:
        """Whether nothing is sent any more."""
        return bool(self.pointer.silent)

    @property
    def deadline_misses(self) -> int:
        """Number of ticks that were skipped."""
        return int(self.pointer.deadline_misses)

    @property
    def overrun(self) -> bool:
        """Whether ticks were missed within the last `OVERRUN_HOLD_NS`."""
        return bool(lib.is_overrun(self.pointer))
