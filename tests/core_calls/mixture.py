"""Gaussian mixtures of a scalar by expectation-maximisation: paper `thermal`, eq. (9)-(18), (21).

The iterations and what is corrected in them: `gaussian_mixture.c`. (21), the plain mean of the
component means, is not the mixture's mean, which is sum_i alpha_i mu_i; both are here.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.records import pointer

Array = NDArray[np.float64]

COMPONENTS: Final = 3
MOST_COMPONENTS: Final[int] = lib.MIXTURE_MAX
ITERATIONS: Final = 30


class Mixture(NamedTuple):
    """weight, mean, variance: (n,) of the components, means in ascending order."""

    weight: Array
    mean: Array
    variance: Array

    @property
    def printed_mean(self) -> float:
        """(21) as printed: every component counts the same, however little it explains."""
        return float(self.mean.mean())

    @property
    def mixed_mean(self) -> float:
        """The mixture's mean."""
        return float(self.weight @ self.mean)

    @property
    def mixed_variance(self) -> float:
        """The mixture's variance, that between the components included."""
        return float(self.weight @ (self.variance + (self.mean - self.mixed_mean) ** 2))


def fit(
    x: Array, components: int = COMPONENTS, iterations: int = ITERATIONS, floor: float = 1e-4
) -> Mixture:
    """Mixture of the values x (N,), N >= components, with variances of at least `floor`.

    Raises ValueError for fewer values, values that are not finite, or more components than
    `MOST_COMPONENTS`.
    """
    if not 0 < components <= MOST_COMPONENTS:
        raise ValueError(f"1 to {MOST_COMPONENTS} components, not {components}")
    if len(x) < components or not np.isfinite(x).all():
        raise ValueError(f"{components} components need as many finite values, got {len(x)}")
    values = np.ascontiguousarray(x, dtype=np.float64)
    found = ffi.new("struct mixture *")
    lib.mixture_fit(
        pointer("double", values), pointer("double", np.sort(values)), len(values), iterations,
        floor, components, found,
    )  # fmt: skip
    parts = (found.weight, found.mean, found.variance)
    return Mixture(*(np.array(list(part)[:components]) for part in parts))


def log_likelihood(x: Array, mixture: Mixture) -> float:
    """sum_s log p(x_s), eq. (9): what every iteration raises."""
    d = x[:, None] - mixture.mean
    density = np.exp(-0.5 * d * d / mixture.variance) / np.sqrt(2.0 * np.pi * mixture.variance)
    return float(np.sum(np.log(density @ mixture.weight)))
