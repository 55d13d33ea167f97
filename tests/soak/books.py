"""What a soak writes down while it runs: memory, descriptors, counters, frames sent."""

import gc
import math
import os
import sys
from array import array
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from dbc.codec import Codec
from tests.storm.campaign import ENDS

PAGE: Final = os.sysconf("SC_PAGE_SIZE")
SETTLED: Final = 0.2
"""Share of the readings before which slopes are not looked at: caches fill, rings too."""
MOST_MB_PER_HOUR: Final = 1.0
MOST_AGE_MS: Final = 100.0
"""Of the newest sample at the end: a loop that loses one tick in a thousand is 3.6 s behind."""


@dataclass
class Books:
    """Readings of the process, and what the gateway has sent, by name.

    In arrays: a number in a list would be one more piece of what is measured.
    """

    codec: Codec
    hours: array = field(default_factory=lambda: array("d"))
    """Time of each reading in the clock that the gateway runs on."""
    rss_mb: array = field(default_factory=lambda: array("d"))
    blocks: array = field(default_factory=lambda: array("q"))
    """Pieces of memory that Python holds: to the piece, where RSS is to the page."""
    descriptors: array = field(default_factory=lambda: array("q"))
    sent: Counter[str] = field(default_factory=Counter)

    def read(self, hours):
        """One reading. Collects garbage: what is left is held."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.hours.append(hours)
        self.rss_mb.append(pages * PAGE / 1e6)
        self.blocks.append(sys.getallocatedblocks())
        self.descriptors.append(len(os.listdir("/proc/self/fd")))  # noqa: PTH208

    def count(self, frames):
        """Frames that the gateway has sent in a tick."""
        by_id = self.codec.by_id
        self.sent.update(by_id[f.can_id].name if f.can_id in by_id else "CANopen" for f in frames)

    def slope(self, readings):
        """Least squares, per hour, after the first readings; NaN of one (a machine that stood)."""
        first = int(len(readings) * SETTLED)
        hours = np.array(self.hours[first:])
        if len(hours) < 2:
            return math.nan
        return float(np.polyfit(hours - hours[0], readings[first:], 1)[0])

    def summary(self):
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


def unaccounted(counts):
    """Frames received that ended in no counter, or in two."""
    return counts["received"] - sum(counts[name] for name in ENDS)


def wrong(result):
    """What of a soak's result may not be; what is not known may not be, either."""
    sent, memory = result["sent"], result["rss_mb_per_hour"]
    first, most = result["descriptors_first"], result["descriptors_most"]
    found = {
        f"{result['unaccounted']} frames in no counter, or in two": result["unaccounted"] == 0,
        f"memory grows by {memory} MB/h": memory <= MOST_MB_PER_HOUR,
        f"{most} descriptors after {first}": most == first,
        f"{sent.get('Gateway_Adhesion', 0)} flag frames in {result['ticks']} ticks":
            sent.get("Gateway_Adhesion", 0) == result["ticks"],
    }  # fmt: skip
    if "frames_sent_to_it" in result:
        told, came = result["frames_sent_to_it"], result["frames_received"]
        drops, age = result["kernel_drops"], result["age_ms_last"]
        found |= {
            f"{came} frames received of {told}": came == told == result["counts"]["received"],
            f"{drops} frames dropped by the kernel": drops == 0,
            f"the newest sample {age} ms old at the end": age <= MOST_AGE_MS,
        }
    return [what for what, holds in found.items() if not holds]
