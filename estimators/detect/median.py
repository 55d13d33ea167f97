"""Median filtering: the simplest detector of paper `adhesion`, section 5.

The paper compares each load with the median and gives no threshold. Ours is a multiple of
the load's own spread, made soft so that the caller's debounce works on a probability.
With a majority of drives slipping the median is on the wrong side; use `vb` there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from estimators.detect import paper
from estimators.detect.protocol import Evidence, Opinion, nobody


@dataclass(frozen=True)
class MedianDetector:
    """Lost when the load is `threshold` spreads below the median, in the load's direction."""

    threshold: float = 3.0

    code: ClassVar[int] = 4

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. `lost` is the probability that the true deviation is beyond it."""
        n = len(evidence.load)
        if np.count_nonzero(evidence.usable) < 2:
            return nobody(n)
        common = float(np.median(evidence.load[evidence.usable]))
        # A coasting train: nothing is carried, so nothing can be missing.
        carried = abs(common) > self.threshold * evidence.spread
        beyond = paper.falls_short(evidence.load, evidence.spread, common, self.threshold)
        lost = np.where(carried & evidence.usable, beyond, 0.0)
        return Opinion(lost, evidence.usable.copy(), common)
