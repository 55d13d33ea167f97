"""k-means with two clusters over the drives' loads: paper `adhesion`, section 5.

The paper uses scipy's `kmeans2` with two iterations from randomly chosen points. Ours starts at
the smallest and the largest load: nothing is random, and neither cluster becomes empty unless all
loads are equal. The adhering centroid is that of the larger cluster. If both clusters have the
same size, it is the centroid of larger magnitude; if the magnitudes are equal too, the upper one.
A drive exactly between the centroids belongs to the lower cluster. The paper gives no threshold:
a drive is lost when its load falls short of the adhering centroid by more than `threshold`
spreads, as in `median`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from estimators.detect import paper
from estimators.detect.protocol import Evidence, Opinion, nobody

ITERATIONS: Final = 2
"""The paper's number of iterations."""


class Clusters(NamedTuple):
    """centroid (T, 2), label (T, N) 0 lower or 1 upper, common (T,): the adhering centroid."""

    centroid: Array
    label: NDArray[np.int64]
    common: Array


def clusters(x: Array, iterations: int = ITERATIONS) -> Clusters:
    """Cluster the loads (T, N) of each tick as scipy's `kmeans2` does from these starts.

    `kmeans2` itself is not used: if distances overflow, it leaves labels unset and crashes on them.
    """
    centroid = np.stack([x.min(axis=-1), x.max(axis=-1)], axis=-1)
    label = np.zeros(x.shape, dtype=np.int64)
    for _ in range(iterations):
        distance = (x[..., None] - centroid[:, None]) ** 2
        label = (distance[..., 1] < distance[..., 0]).astype(np.int64)
        upper = label.sum(axis=-1)
        sums = np.stack([np.sum(x * (1 - label), axis=-1), np.sum(x * label, axis=-1)], axis=-1)
        count = np.stack([x.shape[1] - upper, upper], axis=-1)
        # If all loads are equal, the upper cluster is empty and its centroid stays where it is.
        centroid = np.divide(sums, count, out=centroid, where=count > 0)
    return Clusters(centroid, label, adhering(centroid, label))


def adhering(centroid: Array, label: NDArray[np.int64]) -> Array:
    """Centroid (T,) of the larger cluster; the module docstring has the rule for ties."""
    upper = label.sum(axis=-1)
    lower = label.shape[-1] - upper
    more_load = np.abs(centroid[:, 1]) >= np.abs(centroid[:, 0])
    pick = np.where(upper == lower, more_load, upper > lower)
    return np.where(pick, centroid[:, 1], centroid[:, 0])


def global_estimates(load: Array) -> Array:
    """M_z^(G) of the paper's k-means: loads (T, N) -> (T,)."""
    return clusters(load).common


@dataclass(frozen=True)
class KMeansDetector:
    """A drive is lost if its load is `threshold` spreads short of the larger cluster's centroid."""

    threshold: float = 3.0
    iterations: int = ITERATIONS
    carried: float = 3.0

    code: ClassVar[int] = 3

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. `lost` is the probability that the true shortfall exceeds `threshold`."""
        part = paper.taking_part(evidence)
        if np.count_nonzero(part) < 2:
            return nobody(len(part))
        with np.errstate(all="ignore"):
            load, spread = evidence.load[part], evidence.spread[part]
            common = float(clusters(load[None], self.iterations).common[0])
            lost = paper.falls_short(load, spread, common, self.threshold)
            return paper.opinion(evidence, part, lost, common, self.carried)
