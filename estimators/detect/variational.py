"""Variational Bayes over the drives' loads: paper `adhesion`, section 4.2, eq. (21)-(47).

The equations are in `variational.c`. The priors are ours, because the paper's detect no partial
loss. They state prior knowledge: adhering drives agree to within their spread; a lost drive
carries anything between no load and the full load; losses are rare. The mean of component 0 starts
at every drive's load in turn, and the start with the highest lower bound wins, so that a majority
of slipping drives does not decide what is normal. The price: if one drive's load is far too high
(twice the others'), the others are taken as slipping, as a slipping majority looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from _traction_core import ffi, lib

from dbc.arrays import Array
from estimators.detect.protocol import Evidence, Opinion, nobody


class Priors(NamedTuple):
    """Strength of the prior knowledge.

    nu: degrees of freedom of both precisions (how strongly the given spreads weigh).
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
    """Variational Bayes with priors that detect a partial loss."""

    priors: Priors = DEFAULT_PRIORS
    sweeps: int = 5

    code: ClassVar[int] = 1
    table: Array = field(init=False, repr=False, compare=False)
    """`priors` as one `struct vb_priors`."""

    def __post_init__(self) -> None:
        """Keep the priors in the form the core takes."""
        object.__setattr__(self, "table", np.array(self.priors))

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. The loads of up to 16 usable drives are tried as the adhering one."""
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
