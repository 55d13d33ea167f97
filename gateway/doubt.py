"""What the driver knows against all drives at once: missed ticks, lost frames, a second gateway.

May know: reasons and `now`. May not know: frames, clocks. The intruder state is latched until
restart: receivers cannot tell the two senders apart, so an operator must look. How long the flags
are unknown is the configuration's choice (docs/threats.md).
"""

from __future__ import annotations

from typing import Final

from dbc.frame import SECOND, Nanos
from gateway.health import Reason

OVERRUN_HOLD_NS: Final[Nanos] = SECOND
"""An overrun is said for so long."""
LATE_IN_A_ROW: Final = 3
"""Late ticks in a row after which nothing is believed."""
INTRUDER_HOLD_NS: Final[Nanos] = 10 * SECOND
"""With `on_intruder = "unknown"`: after the last frame of an intruder flags are unknown so long."""
LOST_TICKS: Final = 5
"""After frames that nobody read in time: what was lost may be of any drive."""


class Doubt:
    """Notes of the driver before a step, and what they come to; `tick` once per step."""

    def __init__(
        self, tick_ns: Nanos, *, told_apart: bool = False, intruder_hold_ns: Nanos | None = None
    ) -> None:
        """tick_ns: period of the loop.

        told_apart: receivers can tell our frames from an intruder's, so ours are still good.
        intruder_hold_ns: flags are unknown for so long after its last frame; None: until restart.
        """
        self._told_apart = told_apart
        self._intruder_hold_ns = intruder_hold_ns
        self._intruder_ns: Nanos = 0
        self.deadline_misses = 0
        self.intruder = False
        """Somebody else sends with our identifiers. Latched."""
        self.watching = False
        """Whether frames with our identifiers can only be somebody else's."""
        self._tick_ns = tick_ns
        self._missed = 0
        self._late_in_a_row = 0
        self._overrun_ns: Nanos | None = None
        self._lost = 0
        self._lost_ns: Nanos | None = None
        self._now: Nanos = 0

    def note_overrun(self, missed: int) -> None:
        """So many ticks were skipped before the one that follows."""
        self._missed = missed

    def note_lost(self, frames: int) -> None:
        """So many frames were dropped unread since the last step."""
        self._lost += frames

    def tick(self, now: Nanos, own: int) -> None:
        """own: frames with our own identifiers received in this tick."""
        self._now = now
        self.deadline_misses += self._missed
        self._late_in_a_row = self._late_in_a_row + 1 if self._missed else 0
        if self._missed:
            self._overrun_ns = now
        if self._lost:
            self._lost_ns = now
        self._missed = self._lost = 0
        if self.watching and own > 0:
            self.intruder, self._intruder_ns = True, now

    def none(self, now: Nanos) -> bool:
        """Whether there is no doubt from `now` on until something is noted, whoever is heard."""
        if self.intruder or self.watching or self._missed or self._lost or self._late_in_a_row:
            return False
        recent = (self._overrun_ns, OVERRUN_HOLD_NS), (self._lost_ns, LOST_TICKS * self._tick_ns)
        return all(at is None or now - at > held for at, held in recent)

    @property
    def overrun(self) -> bool:
        """Whether ticks were missed of late."""
        return self._overrun_ns is not None and self._now - self._overrun_ns <= OVERRUN_HOLD_NS

    @property
    def reason(self) -> Reason:
        """Why no adhesion flag can be believed in this tick; NONE if nothing is known against them.

        Of the reasons only an intruder counts against thermal flags, which change slowly.
        """
        hold = self._intruder_hold_ns
        held = hold is None or self._now - self._intruder_ns <= hold
        if self.intruder and held and not self._told_apart:
            return Reason.INTRUDER
        if self._late_in_a_row > LATE_IN_A_ROW:
            return Reason.OVERRUN
        lost = self._lost_ns
        if lost is not None and self._now - lost < LOST_TICKS * self._tick_ns:
            return Reason.SEQUENCE
        return Reason.NONE
