"""What a soak writes down while it runs: memory, descriptors, counters, frames sent."""

from __future__ import annotations

import gc
import math
import os
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from dbc.codec import Codec
from dbc.frame import Frame
from tests.storm.campaign import ENDS

PAGE: Final = os.sysconf("SC_PAGE_SIZE")
SETTLED: Final = 0.2
"""Share of the readings before which slopes are not looked at: caches fill, rings too."""


@dataclass
class Books:
    """Readings of the process, and what the gateway has sent, by name."""

    codec: Codec
    hours: list[float] = field(default_factory=list)
    """Time of each reading in the clock that the gateway runs on."""
    rss_mb: list[float] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    """Pieces of memory that Python holds: to the piece, where RSS is to the page."""
    descriptors: list[int] = field(default_factory=list)
    sent: Counter[str] = field(default_factory=Counter)

    def read(self, hours: float) -> None:
        """One reading. Collects garbage: what is left is held."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.hours.append(hours)
        self.rss_mb.append(pages * PAGE / 1e6)
        self.blocks.append(sys.getallocatedblocks())
        self.descriptors.append(len(os.listdir("/proc/self/fd")))  # noqa: PTH208

    def count(self, frames: list[Frame]) -> None:
        """Frames that the gateway has sent in a tick."""
        by_id = self.codec.by_id
        self.sent.update(by_id[f.can_id].name if f.can_id in by_id else "CANopen" for f in frames)

    def slope(self, readings: list[float] | list[int]) -> float:
        """Least squares, per hour, after the first readings; NaN of one (a machine that stood)."""
        first = int(len(readings) * SETTLED)
        hours = np.array(self.hours[first:])
        if len(hours) < 2:
            return math.nan
        return float(np.polyfit(hours - hours[0], readings[first:], 1)[0])

    def summary(self) -> dict[str, float | int | dict[str, int]]:
        """What the readings come to."""
        first = int(len(self.hours) * SETTLED)
        return {
            "hours": round(self.hours[-1], 3),
            "rss_mb_first": round(self.rss_mb[first], 2),
            "rss_mb_last": round(self.rss_mb[-1], 2),
            "rss_mb_per_hour": round(self.slope(self.rss_mb), 4),
            "python_blocks_per_hour": round(self.slope(self.blocks), 2),
            "descriptors_first": self.descriptors[first],
            "descriptors_most": max(self.descriptors[first:]),
            "sent": dict(sorted(self.sent.items())),
        }


def unaccounted(counts: Counter[str]) -> int:
    """Frames received that ended in no counter, or in two."""
    return counts["received"] - sum(counts[name] for name in ENDS)
