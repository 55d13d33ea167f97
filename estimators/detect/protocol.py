"""Input and output of every adhesion detector.

Detectors are functions of one instant, apart from those in `WITH_MEMORY`. Smoothing, debounce
and latch belong to the caller, so that the same rules apply to all detectors.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Evidence(NamedTuple):
    """The loads of N drives at one instant.

    load: (N,) torque, each referred to full command (the load of a drive cut to 30 % is divided by
    0.3); the gateway gives it per unit of rated torque.
    spread: (N,) in the unit of `load`, standard deviation of a healthy drive's load around the
    common one.
    usable: (N,) bool, false where the load is not known (the entry is then ignored, not NaN).
    speed: (N,) rad/s at the wheel, forward positive, or None; for detectors that observe it.
    """

    load: NDArray[np.float64]
    spread: NDArray[np.float64]
    usable: NDArray[np.bool_]
    speed: NDArray[np.float64] | None = None


class Opinion(NamedTuple):
    """Result of a detector for the N drives.

    lost: (N,) probability of lost adhesion, 0..1; meaningless where not `known`.
    known: (N,) bool. False for unusable drives and where too few drives are left to compare.
    common: the load that adhering drives share, in the unit of the evidence (the paper's global
    estimate M_z^(G)).
    """

    lost: NDArray[np.float64]
    known: NDArray[np.bool_]
    common: float


class Detector(Protocol):
    """A method to detect which drives have lost adhesion."""

    code: ClassVar[int]
    """Value of `Gateway_Adhesion.Detector`."""

    def __call__(self, evidence: Evidence) -> Opinion:
        """Evaluate one instant. Never raises on numbers.

        With fewer than two usable drives none is known.
        """
        ...


def nobody(n: int) -> Opinion:
    """Opinion on n drives of which none is known, as when too few drives can be compared."""
    return Opinion(np.zeros(n), np.zeros(n, dtype=np.bool_), 0.0)
