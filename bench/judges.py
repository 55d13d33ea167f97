"""What the detectors cost: one drive to 1,024, against what a user would write.

VB: one verdict over all drives; against scikit-learn's Bayesian mixture of two, and the NumPy twin.
Sigma-mixed UKF: one sample of every motor; against filterpy's UKF and scikit-learn's mixture.
MAISD: one sample of every motor, window and spread; against the NumPy twin.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from sklearn.mixture import BayesianGaussianMixture, GaussianMixture

from bench.filters import best, ns, us
from estimators import maisd
from estimators.detect import Evidence, VariationalDetector
from estimators.detect.variational import DEFAULT_PRIORS
from estimators.thermal.sigma_mixed import Lumps, SigmaMixedFilter, estimate
from tests.core_calls.maisd import average, push
from tests.reference import maisd as reference
from tests.reference.variational import infer, starts

HEADER = ("detector", "drives", "per call", "per drive", "reference in the same run")
FLEETS: Final = (1, 3, 16, 64, 256, 1024)
LIBRARY: Final = (3, 16)
"""Sizes that the libraries are asked for."""
WINDOW: Final = 60
SAMPLES: Final = 64
"""Of a block of the sigma-mixed filter."""
SPREAD_NM: Final = 0.7


def loads(n: int) -> np.ndarray:
    """Nm: one drive in eight has lost adhesion."""
    rng = np.random.default_rng(n)
    return np.where(np.arange(n) % 8 == 1, 8.0, 20.0) + rng.normal(0.0, SPREAD_NM, n)


def verdict_of(n: int) -> Callable[[], object]:
    evidence = Evidence(loads(n), np.full(n, SPREAD_NM), np.ones(n, dtype=np.bool_))
    return partial(VariationalDetector(), evidence)


def variational(n: int) -> float:
    """s a verdict."""
    return best(verdict_of(n))


def twin(n: int) -> float:
    x = loads(n)
    return best(lambda: infer(x, *starts(x, SPREAD_NM**2), DEFAULT_PRIORS))


def mixture(n: int) -> float:
    """s of scikit-learn's variational mixture of two, five sweeps as ours."""
    x = loads(n)[:, None]
    model = BayesianGaussianMixture(n_components=2, max_iter=5, n_init=1, random_state=0)

    def fit() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(x)

    return best(fit)


def sigma_mixed(n: int) -> float:
    """s a sample of n motors, of a block of `SAMPLES`."""
    rng = np.random.default_rng(0)
    shape = (SAMPLES, n, 3)
    y = 60.0 + rng.normal(0.0, 0.3, shape)
    settled, keep = np.full(shape, 60.0), np.full(shape, 0.99)
    none, gap = np.zeros((n, 3)), np.ones(SAMPLES)
    known = Lumps(none, none, none, none + 0.2, none + 0.1, np.array([10.0, -4.0, -6.0]))
    configs = SigmaMixedFilter().configs(known, none)
    return best(lambda: estimate(configs, y, settled, keep, gap)) / SAMPLES


def library_mixed() -> float:
    """s a sample of one motor: filterpy's UKF, its points pooled in a scikit-learn mixture."""
    points = MerweScaledSigmaPoints(3, 1.0, 0.0, 0.0)
    ukf = UnscentedKalmanFilter(
        3, 3, 1.0, lambda x: x, lambda x, _dt: 60.0 + 0.99 * (x - 60.0), points
    )
    ukf.x, ukf.Q, ukf.R = np.full(3, 60.0), 0.2 * np.eye(3), 0.1 * np.eye(3)
    y, apart = np.full(3, 60.2), np.array([10.0, -4.0, -6.0])
    model = GaussianMixture(n_components=3, max_iter=10, random_state=0)

    def step() -> None:
        ukf.predict()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit((ukf.sigmas_f - apart).reshape(-1, 1))
        ukf.x = ukf.x + 0.2 * (model.means_.mean() - ukf.x.mean())
        ukf.update(y)

    return best(step)


def spread(n: int) -> float:
    """s a sample of n motors through the compiled MAISD."""
    rng = np.random.default_rng(0)
    ring = maisd.window(WINDOW, n, 3)
    values, present = rng.normal(60.0, 1.0, (n, 3)), np.ones((n, 3), dtype=np.bool_)
    seen = 0

    def take() -> None:
        nonlocal seen
        push(ring, seen, values, present)
        maisd.compare(*average(ring))
        seen += 1

    for _ in range(WINDOW):
        take()
    return best(take)


def plain_spread(n: int) -> float:
    rng = np.random.default_rng(0)
    state = reference.start(WINDOW, n, 3)
    values, present = rng.normal(60.0, 1.0, (n, 3)), np.ones((n, 3), dtype=np.bool_)
    for _ in range(WINDOW):
        state = reference.push(state, values, present)

    def take() -> None:
        mean, known = reference.average(reference.push(state, values, present))
        reference.maisd(mean, known), reference.deviation(mean, known)

    return best(take)


def rows() -> list[tuple[str, ...]]:
    one_mixed = library_mixed()
    out = []
    for n in FLEETS[1:]:
        against = [("NumPy twin", twin)] + [("scikit-learn", mixture)] * (n in LIBRARY)
        out.append(_row("VB, a verdict", n, variational(n), against))
    for n in FLEETS:
        spent = sigma_mixed(n)
        out.append((
            "sigma-mixed UKF, a sample", str(n), us(spent), ns(spent / n, 0),
            f"filterpy + scikit-learn {one_mixed * n / spent:.0f} x",
        ))  # fmt: skip
    out += [_row("MAISD, a sample", n, spread(n), [("NumPy twin", plain_spread)]) for n in FLEETS]
    return out


def _row(
    what: str, n: int, spent: float, against: list[tuple[str, Callable[[int], float]]]
) -> tuple[str, ...]:
    said = ", ".join(f"{name} {theirs(n) / spent:.0f} x" for name, theirs in against)
    return what, str(n), us(spent), ns(spent / n, 0), said
