"""Gaussian mixtures of a scalar by expectation-maximisation: paper `thermal`, eq. (9)-(18), (21).

Corrections: (12)-(18) mix up the indices of sample and component; (15) is
alpha_i phi_i / sum_j alpha_j phi_j. The variance in (18) uses the new mean, and needs a floor, or
a component collapses onto one value. Components start at spread quantiles and are kept in order,
so that they do not change places. (21), the plain mean of the component means, is not the mixture's
mean, which is sum_i alpha_i mu_i; both are here.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.thermal._mixture_kernels import expect_maximise

Array = NDArray[np.float64]

COMPONENTS: Final = 3
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

    Raises ValueError for fewer values, or values that are not finite.
    """
    if len(x) < components or not np.isfinite(x).all():
        raise ValueError(f"{components} components need as many finite values, got {len(x)}")
    out = np.empty((3, components))
    expect_maximise(np.ascontiguousarray(x), iterations, floor, out)
    return Mixture(*out)


def log_likelihood(x: Array, mixture: Mixture) -> float:
    """sum_s log p(x_s), eq. (9): what every iteration raises."""
    d = x[:, None] - mixture.mean
    density = np.exp(-0.5 * d * d / mixture.variance) / np.sqrt(2.0 * np.pi * mixture.variance)
    return float(np.sum(np.log(density @ mixture.weight)))
