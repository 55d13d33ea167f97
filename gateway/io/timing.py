"""Where the time goes between a frame's reception and its flag: a histogram per stage.

The deciding frame is that of the newest sample on which the tick's flags rest, stamped by the
kernel on reception. It waits for the tick, and then for every stage of the tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from dbc.frame import Nanos
from gateway.io.realtime import Histogram

STAGES: Final = ("waiting", "reading", "deciding", "sending", "frame to flag")
"""Each stage begins where the one before it ends. They end when the tick begins, when the queue is
read, when the core has decoded, estimated, decided and encoded, and when the tick's last frame is
handed over. The first begins at the kernel's stamp; the last is the sum."""


class Stage(NamedTuple):
    """One histogram, ns. octaves: (from, below, count) by powers of two, including empty ones."""

    name: str
    values: int
    p50: int
    p99: int
    p999: int
    largest: int
    octaves: Sequence[tuple[int, int, int]]


class Timing:
    """Histograms of all stages, ns. Never grows."""

    def __init__(self, lateness: Histogram) -> None:
        """lateness: histogram of the ticks' lateness, kept by the ticker."""
        self.lateness = lateness
        self.stages = {name: Histogram() for name in STAGES}
        self._decided: Nanos | None = None

    @property
    def latency(self) -> Histogram:
        """Histogram of the time from frame to flag."""
        return self.stages[STAGES[-1]]

    def stage_rows(self) -> list[Stage]:
        """All histograms, lateness first, for a report."""
        return [
            Stage(
                name, h.total, h.quantile(0.5), h.quantile(0.99), h.quantile(0.999), h.largest,
                h.octaves(),
            )
            for name, h in {"lateness": self.lateness, **self.stages}.items()
        ]  # fmt: skip

    def record(
        self, decided: Nanos | None, woken: Nanos, read: Nanos, stepped: Nanos, sent: Nanos
    ) -> None:
        """Count one tick. decided: stamp of the deciding frame.

        With None, or the same frame as before, nothing is counted: nothing new was decided.
        """
        if decided is None or decided == self._decided:
            return
        self._decided = decided
        # A frame may arrive between the beginning of the tick and the reading of the queue.
        begun = max(woken, decided)
        spans = (begun - decided, read - begun, stepped - read, sent - stepped, sent - decided)
        for histogram, span in zip(self.stages.values(), spans, strict=True):
            histogram.count(span)
