"""Detectors of lost adhesion: one protocol, one table of names.

A new detector is one module here, one line in `DETECTORS`, its unit test and one scenario.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

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
"""Names as in `[adhesion] detector`; the classes carry the code that goes on the bus."""

WITH_MEMORY: Final[dict[str, type[Detector]]] = {
    "paper_vb_reuse": ReusingVariationalDetector,
    "switching": SwitchingDetector,
}
"""Detectors whose answer depends on the calls before: one object for one sequence of ticks."""


def make(
    name: str, observe: str = "torque", tolerance: float = 0.0, reuse: float = 0.0
) -> Detector:
    """A detector by its name.

    Of the paper's VB: observe: "torque", "speed" or "both"; tolerance: of the bound that ends the
    sweeps, 0: five sweeps; reuse: share of the last posterior in the next prior, 0: none, or what
    `paper_vb_reuse` has of its own.

    Raises KeyError for an unknown name, TypeError where another detector is given any of these.
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


GLOBAL_ESTIMATES: Final[dict[str, Callable[[paper.Array], paper.Array]]] = {
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
