"""Detectors of lost adhesion: one protocol, one table of names.

A new detector is one module here, one line in `DETECTORS`, its unit test and one scenario.
"""

from __future__ import annotations

from estimators.detect.median import MedianDetector
from estimators.detect.protocol import Detector, Evidence, Opinion
from estimators.detect.variational import VariationalDetector

DETECTORS: dict[str, type[Detector]] = {
    "vb": VariationalDetector,
    "median": MedianDetector,
}
"""Names as in `[adhesion] detector`; the classes carry the code that goes on the bus."""

__all__ = ["DETECTORS", "Detector", "Evidence", "MedianDetector", "Opinion", "VariationalDetector"]
