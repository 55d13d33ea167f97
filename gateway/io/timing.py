"""Where the time goes between a frame's reception and its flag: a histogram per stage.

The frame that decides is the one of the newest sample that the tick's flags rest on, stamped by the
kernel as it came in. It waits for the tick, and then for everything that the tick does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from dbc.frame import Nanos
from gateway.io.realtime import Histogram

STAGES: Final = ("waiting", "reading", "deciding", "sending", "frame to flag")
"""From the kernel's stamp until the tick begins; until the queue is read; until the core has
decoded, estimated, decided and encoded; until the tick's last frame is handed over. Then all of it
together."""


class Stage(NamedTuple):
    """One histogram. ns; octaves: (from, below, count) in powers of two, empty ones between."""

    name: str
    values: int
    p50: int
    p99: int
    p999: int
    largest: int
    octaves: Sequence[tuple[int, int, int]]


class Timing:
    """Histograms, ns. Never grows."""

    def __init__(self, lateness: Histogram) -> None:
        """lateness: of the ticks, kept by the ticker."""
        self.lateness = lateness
        self.stages = {name: Histogram() for name in STAGES}
        self._decided: Nanos | None = None

    @property
    def latency(self) -> Histogram:
        """From frame to flag."""
        return self.stages[STAGES[-1]]

    def stage_rows(self) -> list[Stage]:
        """All of them, lateness first, for a report."""
        return [
            Stage(
                name, h.total, h.quantile(0.5), h.quantile(0.99), h.quantile(0.999), h.largest,
                h.octaves(),
            )
            for name, h in {"lateness": self.lateness, **self.stages}.items()
        ]  # fmt: skip

    def add(
        self, decided: Nanos | None, woken: Nanos, read: Nanos, stepped: Nanos, sent: Nanos
    ) -> None:
        """One tick. decided: when the deciding frame came in.

        None, or one that has decided before, is not counted: nothing new was decided.
        """
        if decided is None or decided == self._decided:
            return
        self._decided = decided
        # A frame may come in between the tick's begin and the reading of the queue.
        begun = max(woken, decided)
        spans = (begun - decided, read - begun, stepped - read, sent - stepped, sent - decided)
        for histogram, span in zip(self.stages.values(), spans, strict=True):
            histogram.add(span)
