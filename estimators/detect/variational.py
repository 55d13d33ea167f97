"""Variational Bayes over the drives' loads: paper `adhesion`, section 4.2, eq. (21)-(47).

The equations are in `variational.c`. The priors are ours, because the paper's never see a partial
loss. They state what the problem knows: adhering drives agree to within their spread; a lost drive
carries anything between nothing and everything; losses are rare. The mean of component 0 is
started at every drive's load in turn and the start with the highest lower bound wins: a majority
of slipping drives does not decide what is normal. The price: one drive that reads far too much
(twice the others) explains them as slipping, because that is what a slipping majority looks like.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from estimators.detect.protocol import Evidence, Opinion, nobody

Array = NDArray[np.float64]


class Priors(NamedTuple):
    """Strength of what is known before looking.

    nu: degrees of freedom of both precisions (how firmly the spreads are believed).
    beta_adhering, beta_lost: weight of the component means' priors, in drives.
    alpha_adhering, alpha_lost: the beta prior of the share of lost drives.
    """

    nu: float = 12.0
    beta_adhering: float = 0.05
    beta_lost: float = 50.0
    alpha_adhering: float = 9.5
    alpha_lost: float = 0.5


DEFAULT_PRIORS = Priors()


@dataclass(frozen=True)
class VariationalDetector:
    """Variational Bayes with priors that state the problem."""

    priors: Priors = DEFAULT_PRIORS
    sweeps: int = 5

    code: ClassVar[int] = 1
    table: Array = field(init=False, repr=False, compare=False)
    """`priors` as one `struct vb_priors`."""

    def __post_init__(self) -> None:
        """Keep the priors in the form the core takes."""
        object.__setattr__(self, "table", np.array(self.priors))

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. Two to N usable drives; each of up to 16 is tried as the adhering one."""
        n = len(evidence.load)
        if np.count_nonzero(evidence.usable) < 2:
            return nobody(n)
        lost, workspace = np.empty(n), np.empty(5 * n)
        load = np.ascontiguousarray(evidence.load, dtype=np.float64)
        spread = np.ascontiguousarray(evidence.spread, dtype=np.float64)
        usable = np.ascontiguousarray(evidence.usable, dtype=np.bool_)
        common = lib.vb_detect(
            ffi.from_buffer("struct vb_priors *", self.table), self.sweeps,
            ffi.from_buffer("double[]", load), ffi.from_buffer("double[]", spread),
            ffi.from_buffer("uint8_t[]", usable), n, ffi.from_buffer("double[]", workspace),
            ffi.from_buffer("double[]", lost),
        )  # fmt: skip
        return Opinion(lost, evidence.usable.copy(), common)
