"""Missed ticks, lost frames, a second gateway: the reference of `gateway/core/integrity.c`."""

from __future__ import annotations

from dbc.frame import SECOND
from gateway.core.codes import Reason

OVERRUN_HOLD_NS = SECOND
LATE_IN_A_ROW = 3
LOST_TICKS = 5


class IntegrityMonitor:
    """Notes of the driver before a step; `tick` once per step."""

    def __init__(
        self, tick_ns: int, *, authenticated: bool = False, intruder_hold_ns: int | None = None,
        stops: bool = False,
    ) -> None:  # fmt: skip
        """tick_ns: period of the loop.

        authenticated: receivers can tell our frames from an intruder's, so ours are still good.
        intruder_hold_ns: flags are unknown for so long after its last frame; None: until restart.
        """
        self._authenticated = authenticated
        self.silent = self.mute = False
        self._stops = stops
        self._intruder_hold_ns = intruder_hold_ns
        self._intruder_ns: int = 0
        self.deadline_misses = 0
        self.intruder = False
        """Somebody else sends with our identifiers. Latched."""
        self.watching = False
        """Whether frames with our identifiers can only be somebody else's."""
        self._tick_ns = tick_ns
        self._missed = 0
        self._late_in_a_row = 0
        self._overrun_ns: int | None = None
        self._lost = 0
        self._lost_ns: int | None = None
        self._now: int = 0

    def note_overrun(self, missed: int) -> None:
        """So many ticks were skipped before the one that follows."""
        self._missed = missed

    def note_lost(self, frames: int) -> None:
        """So many frames were dropped unread since the last step."""
        self._lost += frames

    def tick(self, now: int, own: int) -> None:
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
        self.mute, self.silent = self.silent, self._stops and self.intruder

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
        if self.intruder and held and not self._authenticated:
            return Reason.INTRUDER
        if self._late_in_a_row > LATE_IN_A_ROW:
            return Reason.OVERRUN
        lost = self._lost_ns
        if lost is not None and self._now - lost < LOST_TICKS * self._tick_ns:
            return Reason.SEQUENCE
        return Reason.NONE
