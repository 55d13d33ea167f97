"""Detectors of lost adhesion: one protocol, one table of names.

A new detector needs a module here, a line in `DETECTORS`, a unit test and a scenario.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from dbc.arrays import Array
from estimators.detect import kmeans, message_passing, paper, paper_vb
from estimators.detect.kmeans import KMeansDetector
from estimators.detect.median import MedianDetector
from estimators.detect.message_passing import MessagePassingDetector
from estimators.detect.paper_vb import PaperVariationalDetector, ReusingVariationalDetector
from estimators.detect.protocol import Detector, Evidence, Opinion
from estimators.detect.switching import SwitchingDetector
from estimators.detect.variational import VariationalDetector

DETECTORS: dict[str, type[Detector]] = {
    "vb": VariationalDetector,
    "median": MedianDetector,
    "kmeans": KMeansDetector,
    "vmp": MessagePassingDetector,
    "paper_vb": PaperVariationalDetector,
}
"""Detectors by their name in `[adhesion] detector`; each class has the code sent on the bus."""

WITH_MEMORY: Final[dict[str, type[Detector]]] = {
    "paper_vb_reuse": ReusingVariationalDetector,
    "switching": SwitchingDetector,
}
"""Detectors whose result depends on earlier calls: each sequence of ticks needs its own object."""


def make(
    name: str, observe: str = "torque", tolerance: float = 0.0, reuse: float = 0.0
) -> Detector:
    """Make a detector by its name.

    The other arguments belong to the paper's VB. observe: "torque", "speed" or "both"; tolerance:
    relative rise of the bound below which the sweeps end, 0: five sweeps; reuse: share of the last
    posterior in the next prior, 0: none, but `paper_vb_reuse` keeps its own default.

    Raises KeyError for an unknown name, TypeError if another detector gets any of these arguments.
    """
    kind = (DETECTORS | WITH_MEMORY)[name]
    if not issubclass(kind, PaperVariationalDetector):
        if (observe, tolerance, reuse) != (paper.Observe.TORQUE.value, 0.0, 0.0):
            msg = f"{name} compares torque only, has no bound and reuses nothing"
            raise TypeError(msg)
        return kind()
    how: dict[str, Any] = {"observe": paper.Observe(observe)}
    if tolerance > 0.0:
        how |= {"tolerance": tolerance, "sweeps": paper.MOST_SWEEPS}
    if reuse > 0.0:
        kind, how = ReusingVariationalDetector, {**how, "phi": reuse}
    return kind(**how)


GLOBAL_ESTIMATES: Final[dict[str, Callable[[Array], Array]]] = {
    "paper_vb": paper_vb.global_estimates,
    "vmp": message_passing.global_estimates,
    "kmeans": kmeans.global_estimates,
    "median": paper.medians,
}
"""The paper's four methods over whole records: loads (T, N) in Nm to M_z^(G) (T,)."""

__all__ = [
    "DETECTORS",
    "GLOBAL_ESTIMATES",
    "WITH_MEMORY",
    "Detector",
    "Evidence",
    "KMeansDetector",
    "MedianDetector",
    "MessagePassingDetector",
    "Opinion",
    "PaperVariationalDetector",
    "ReusingVariationalDetector",
    "SwitchingDetector",
    "VariationalDetector",
    "make",
]
