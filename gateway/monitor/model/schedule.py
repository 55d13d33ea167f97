"""Lateness of a cyclic message, measured without the sender's clock. Pure."""

from __future__ import annotations

from typing import Final

from dbc.frame import SECOND, Nanos
from gateway.io.realtime import Histogram
from gateway.monitor.model.snapshot import Lateness

DRIFT: Final = 100e-6
"""Largest relative drift between the clocks of sender and monitor."""
COUNTERS: Final = 16
ANEW_NS: Final[Nanos] = SECOND // 10
"""After this time without a frame, or with a larger lateness, the grid is determined again."""


class Schedule:
    """The time grid on which frames are sent, found from the earliest of them.

    No frame comes before it is due, so the earliest ones lie on the grid. The grid follows later
    frames no faster than two clocks can drift apart. A constant delay is not visible.
    """

    def __init__(self, period_ns: Nanos) -> None:
        """period_ns: of the message; with 0 no frame is counted."""
        self._period_ns = period_ns
        self._due_ns: Nanos | None = None
        self._counter = 0
        self._last_ns: Nanos = 0
        self.histogram = Histogram()
        """Lateness in microseconds."""

    def observe(self, t_ns: Nanos, counter: int) -> None:
        """Add an accepted frame. counter: its E2E counter, modulo 16."""
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
        # The allowance for drift is no lateness, and is far smaller than a bucket.
        self.histogram.count(max(late, 0) // 1000)

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
