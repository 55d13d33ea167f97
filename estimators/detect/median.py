"""Median filtering: the simplest detector of paper `adhesion`, section 5.

The paper compares each load with the median and gives no threshold. Ours is a multiple of
the load's own spread, made soft so that the caller's debounce works on a probability.
If most drives slip, the median is the load of a slipping drive; use `vb` against that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from estimators.detect import paper
from estimators.detect.protocol import Evidence, Opinion, nobody


@dataclass(frozen=True)
class MedianDetector:
    """A drive is lost if its load is `threshold` spreads short of the median, in either sign."""

    threshold: float = 3.0

    code: ClassVar[int] = 4

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. `lost` is the probability that the true deviation exceeds `threshold`."""
        n = len(evidence.load)
        if np.count_nonzero(evidence.usable) < 2:
            return nobody(n)
        common = float(np.median(evidence.load[evidence.usable]))
        # On a coasting train the drives carry no load, so no load can be missing.
        carried = abs(common) > self.threshold * evidence.spread
        beyond = paper.falls_short(evidence.load, evidence.spread, common, self.threshold)
        lost = np.where(carried & evidence.usable, beyond, 0.0)
        return Opinion(lost, evidence.usable.copy(), common)
