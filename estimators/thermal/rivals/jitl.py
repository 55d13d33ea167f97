"""Just-in-time learning (Cheng, Chiu 2004): paper `thermal`, Table 2.

For every sample a local linear model, from the fault-free samples most like it, predicts each
temperature; the statistic is the norm of the residuals, in standard deviations.

With `others` it exploits that the motors are alike.
Tried on seeds 0, 2 .. 8: 20 to 150 neighbours, ridge 1 or 10, with and without `others` and
`joint`, means of 0 or 2 %; `others` and `joint` won 0.1 and 0.04 of mean AUC at 1 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbc.arrays import Array, Ints
from estimators.thermal.record import Record, features
from estimators.thermal.rivals.dpca import TINY, Scorer, against_others, filled, moving, span, usual


@dataclass(frozen=True)
class Jitl:
    """Tuning of just-in-time learning.

    neighbours: k; ridge: of the local regression, in samples; others: whether what is predicted
    is the difference to the other motors' median; joint: whether residuals are weighted by their
    covariance, not only their own variances; window: share of the run's samples over which they
    are averaged; most: fault-free samples that are kept.
    """

    neighbours: int = 60
    ridge: float = 10.0
    others: bool = True
    joint: bool = True
    window: float = 0.02
    most: int = 1500
    name: str = "jitl"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. Raises ValueError for fewer than 10 samples."""
        from sklearn.neighbors import NearestNeighbors

        if len(healthy.at) < 10:
            raise ValueError(f"{len(healthy.at)} samples are too few")
        start = usual(healthy.temperature)
        every = slice(None, None, -(-len(healthy.at) // self.most))
        inputs, targets = rises(healthy, start, self.others)
        centre, scale = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-3)
        inputs = (inputs - centre) / scale
        store, known = inputs[every], targets[every]
        search = NearestNeighbors(n_neighbors=min(self.neighbours, len(store) - 1))
        search.fit(store)

        def residual(inputs: Array, targets: Array, far: Array, near: Ints) -> Array:
            return targets - _local(inputs, store[near], known[near], far, self.ridge)

        # Without a query, a sample is not its own neighbour.
        far, near = search.kneighbors()
        own = residual(store, known, far, near)
        window = span(healthy, self.window)
        norm = Norm.of(own, max(round(window / (every.step or 1)), 1), window, self.joint)

        def score(record: Record) -> Array:
            inputs, targets = rises(record, start, self.others)
            inputs = (inputs - centre) / scale
            far, near = search.kneighbors(inputs)
            return norm(residual(inputs, targets, far, near))

        return score


def rises(record: Record, start: Array, others: bool) -> tuple[Array, Array]:
    """(K, U) inputs and (K, 3 M) targets, K above the ambient; `others`: less their median."""
    known = features(record)
    rise = filled(record.temperature, start) - known[:, :1, None]
    if others and record.motors > 1:
        rise = against_others(rise)
    return known[:, 1:], rise.reshape(len(rise), -1)


class Norm(NamedTuple):
    """Norm of averaged residuals, in standard deviations of the residuals of the fit's run.

    centre: (V,) and weight: (V, V): mean and inverse covariance of these; window: samples averaged.
    """

    centre: Array
    weight: Array
    window: int

    @classmethod
    def of(cls, own: Array, own_window: int, window: int, joint: bool) -> Norm:
        """From (K, V) fault-free residuals, `own_window` of which span the time of `window`."""
        centre = own.mean(axis=0)
        shape = np.atleast_2d(np.cov(moving(own - centre, own_window), rowvar=False))
        if not joint:
            shape = np.diag(np.diag(shape))
        # At least a hundredth of the mean variance: so few independent samples prove no less.
        floor = 1e-2 * float(np.trace(shape)) / len(shape) + TINY
        weight = np.linalg.inv(shape + floor * np.eye(len(shape)))
        return cls(centre, np.asarray(weight, dtype=np.float64), window)

    def __call__(self, residual: Array) -> Array:
        """(K,) of (K, V); about 1 where nothing is wrong."""
        off = moving(residual - self.centre, self.window)
        square = np.einsum("ki,ij,kj->k", off, self.weight, off)
        out: Array = np.sqrt(np.maximum(square, 0.0) / len(self.centre))
        return out


def _local(query: Array, near: Array, known: Array, far: Array, ridge: float) -> Array:
    """(Q, P) prediction at (Q, V) from (Q, k, V) and (Q, k, P) at distances (Q, k)."""
    reach = np.maximum(far[:, -1:], TINY)
    # Tricube: the prediction does not jump when the k-th neighbour changes.
    weight = (1.0 - np.minimum(far / reach, 1.0) ** 3) ** 3 + TINY
    weight /= weight.sum(axis=1, keepdims=True)
    near_mean = np.einsum("qk,qkv->qv", weight, near)
    known_mean = np.einsum("qk,qkp->qp", weight, known)
    x, y = near - near_mean[:, None], known - known_mean[:, None]
    wx = weight[:, :, None] * x
    gram = np.matmul(wx.transpose(0, 2, 1), x)
    gram += np.eye(gram.shape[1]) * (ridge / far.shape[1])
    slope = np.linalg.solve(gram, np.matmul(wx.transpose(0, 2, 1), y))
    out: Array = known_mean + np.einsum("qv,qvp->qp", query - near_mean, slope)
    return out
