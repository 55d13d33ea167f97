"""Deep slow feature analysis: paper `thermal`, Table 2.

Two layers of slow feature analysis (Wiskott, Sejnowski 2002), with a quadratic expansion between
them. Monitored as by Shang et al. 2015: S^2 is the power in the slow features, S_e^2 in the fast
rest. The first layer's features that do not go on to the second layer count as rest, too.

With the view "between" it exploits that the motors are alike.
Tried on seeds 0, 2 .. 8: two views, 0 or 1 lags, width 3 to 17, slow 0.3 or 0.5, clipping before
the expansion, means of 0 to 5 %; width 14 won (mean F at 1 Hz 0.70, of width 3 0.27: false alarms).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.record import Record
from estimators.thermal.rivals.dpca import TINY, Scorer, View, span


@dataclass(frozen=True)
class Dsfa:
    """Tuning of deep slow feature analysis.

    lags: samples before the present one in a row; width: features of the first layer that go
    on; slow: share of the second layer's features that count as slow; window: share of the run's
    samples over which the rows are averaged; view: see `View`.
    """

    lags: int = 0
    width: int = 14
    slow: float = 0.5
    window: float = 0.02
    view: str = "between"
    name: str = "dsfa"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. Raises ValueError if it is too short for the lags."""
        view = View.of(healthy, self.view)
        window = span(healthy, self.window)
        rows = view.rows(healthy, window, self.lags)[self.lags :]
        if len(rows) < 3:
            raise ValueError(f"{len(healthy.at)} samples are too few for {self.lags} lags")
        first = Slow.fit(rows)
        lower = first(rows)
        second = Slow.fit(_expanded(lower[:, : self.width]))
        slow = max(round(self.slow * second.features), 1)

        def statistics(rows: Array) -> Array:
            lower = first(rows)
            upper = second(_expanded(lower[:, : self.width]))
            rest = (upper[:, slow:] ** 2).sum(axis=1) + (lower[:, self.width :] ** 2).sum(axis=1)
            return np.stack([(upper[:, :slow] ** 2).sum(axis=1), rest], axis=1)

        return view.scorer(("S²", "S²e"), statistics, rows, window, self.lags)


class Slow(NamedTuple):
    """One linear layer: (V,) centre and (V, F) weights, slowest feature first.

    On the data of the fit every feature is of variance 1, and no two are correlated.
    """

    centre: Array
    weights: Array

    @classmethod
    def fit(cls, rows: Array, least: float = 1e-4) -> Slow:
        """Fit to (K, V), K > 1. Directions below `least` of the largest variance are left out."""
        from scipy.linalg import eigh

        centre = rows.mean(axis=0)
        power, axes = eigh(np.cov(rows - centre, rowvar=False))
        keep = power > max(least * power[-1], TINY**2)
        white = axes[:, keep] / np.sqrt(power[keep])
        change = np.diff((rows - centre) @ white, axis=0)
        # Ascending eigenvalues: the slowest first.
        _, turn = eigh(change.T @ change / len(change))
        return cls(centre, white @ turn)

    @property
    def features(self) -> int:
        """F."""
        return int(self.weights.shape[1])

    def __call__(self, rows: Array) -> Array:
        """(K, F) features of (K, V)."""
        out: Array = (rows - self.centre) @ self.weights
        return out


def _expanded(features: Array) -> Array:
    """(K, F + F (F + 1) / 2): the features and their products."""
    i, j = np.triu_indices(features.shape[1])
    return np.concatenate([features, features[:, i] * features[:, j]], axis=1)
