"""What every adhesion detector takes and gives.

Detectors are functions of one instant: memory (smoothing, debounce, latch) belongs to the
caller, so that all detectors are judged by the same rules.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Evidence(NamedTuple):
    """The loads of N drives at one instant.

    load: (N,) Nm, each referred to full command (a drive cut to 30 % is divided by 0.3).
    spread: (N,) Nm, standard deviation a healthy drive's load shows around the common one.
    usable: (N,) bool, false where the load is not known (the entry is then ignored, not NaN).
    speed: (N,) rad/s at the wheel, forward positive, or None; for detectors that observe it.
    """

    load: NDArray[np.float64]
    spread: NDArray[np.float64]
    usable: NDArray[np.bool_]
    speed: NDArray[np.float64] | None = None


class Opinion(NamedTuple):
    """What a detector thinks of the N drives.

    lost: (N,) probability of lost adhesion, 0..1; meaningless where not `known`.
    known: (N,) bool. False for unusable drives and where too few drives are left to compare.
    common: the load that adhering drives share, Nm (the paper's global estimate M_z^(G)).
    """

    lost: NDArray[np.float64]
    known: NDArray[np.bool_]
    common: float


class Detector(Protocol):
    """One way to tell which drives have lost adhesion."""

    code: ClassVar[int]
    """Value of `Gateway_Adhesion.Detector`."""

    def __call__(self, evidence: Evidence) -> Opinion:
        """Judge one instant. Never raises on numbers; fewer than two usable drives: unknown."""
        ...


def nobody(n: int) -> Opinion:
    """Too few drives to compare: nothing is known."""
    return Opinion(np.zeros(n), np.zeros(n, dtype=np.bool_), 0.0)
