"""Detectors of lost adhesion: one protocol, one table of names.

A new detector is one module here, one line in `DETECTORS`, its unit test and one scenario.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

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


def make(name: str, observe: str = "torque") -> Detector:
    """A detector by its name; observe: "torque", "speed" or "both", for the paper's VB.

    Raises KeyError for an unknown name, TypeError where another one is to observe speed.
    """
    kind = (DETECTORS | WITH_MEMORY)[name]
    if observe == paper.Observe.TORQUE.value:
        return kind()
    if not issubclass(kind, PaperVariationalDetector):
        msg = f"{name} compares torque only"
        raise TypeError(msg)
    return kind(observe=paper.Observe(observe))


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
