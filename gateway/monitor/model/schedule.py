"""Lateness of a cyclic message, measured without its sender's clock. Pure."""

from __future__ import annotations

from typing import Final

from dbc.frame import SECOND, Nanos
from gateway.io.realtime import Histogram
from gateway.monitor.model.snapshot import Lateness

DRIFT: Final = 100e-6
"""Most by which the clocks of sender and monitor may differ."""
COUNTERS: Final = 16
ANEW_NS: Final[Nanos] = SECOND // 10
"""So long without a frame, or so far off: the schedule is looked for anew."""


class Schedule:
    """The grid on which frames are sent, found from the earliest of them.

    No frame comes before it is due, so the earliest ones lie on the grid; it follows later ones no
    faster than two clocks can drift apart. A delay that never changes cannot be seen this way.
    """

    def __init__(self, period_ns: Nanos) -> None:
        """period_ns: of the message; 0 counts nothing."""
        self._period_ns = period_ns
        self._due_ns: Nanos | None = None
        self._counter = 0
        self._last_ns: Nanos = 0
        self.histogram = Histogram()
        """Microseconds."""

    def add(self, t_ns: Nanos, counter: int) -> None:
        """A believed frame. counter: its protection counter, modulo 16."""
        period = self._period_ns
        if period <= 0:
            return
        steps = (counter - self._counter) % COUNTERS
        quiet = t_ns - self._last_ns > ANEW_NS
        due = self._due_ns
        self._counter, self._last_ns = counter, t_ns
        if due is None or quiet or not steps:
            self._due_ns = t_ns
            return
        due += round(steps * period * (1.0 + DRIFT))
        late = t_ns - due
        if late < 0 or late > ANEW_NS:
            due = t_ns
        self._due_ns = due
        # The allowance for drift is not lateness of the frame, and is far below a bucket.
        self.histogram.add(max(late, 0) // 1000)

    def lateness(self) -> Lateness:
        """The histogram so far."""
        h = self.histogram
        rows = h.octaves()
        if not rows:
            return Lateness()
        edges = (*(low for low, _, _ in rows), rows[-1][1])
        return Lateness(
            edges, tuple(n for _, _, n in rows), h.total, h.quantile(0.99), h.largest
        )  # fmt: skip
