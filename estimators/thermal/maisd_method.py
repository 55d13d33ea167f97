"""The paper's fault detection: paper `thermal`, eq. (22)-(31), Algorithms 1 and 2.

The sigma-mixed filter estimates the states of all motors, with the degradation's drift in its
prediction. The spread between the motors' moving averages, at each of the three points, has a limit
from fault-free data. As printed, the average (29) looks ahead; `causal` ends its window at the
sample, as on a bus. `centred` first subtracts each motor's own mean in health, which (31) lacks:
without it a constant difference between healthy motors is part of the statistic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal import degradation
from estimators.thermal.record import Record
from estimators.thermal.rivals.dpca import filled, usual
from estimators.thermal.sigma_mixed import MIXING, Estimates, Lumps, SigmaMixedFilter, lumps

LIMIT: float = 0.99


def moving_average(x: Array, window: int, *, causal: bool) -> Array:
    """(29): (K, ...) means over `window` samples from k on, or up to k; shorter at the end."""
    total = np.cumsum(np.concatenate([np.zeros_like(x[:1]), x]), axis=0)
    k = np.arange(len(x))
    low = np.maximum(k - window + 1, 0) if causal else k
    high = k + 1 if causal else np.minimum(k + window, len(x))
    count = (high - low).reshape(-1, *[1] * (x.ndim - 1))
    return np.asarray((total[high] - total[low]) / count)


def maisd(average: Array) -> Array:
    """(31): (K, M, 3) -> (K, 3), the spread of the M motors around their mean."""
    return np.asarray(average.std(axis=1))


Filtering = Callable[[Record, Lumps, Array | None], Estimates]
"""Estimates the states of a record with a thermal model and a drift (M, 3) K/s or None."""


class Learnt(NamedTuple):
    """known: the thermal model; drift (M, 3) K/s or None; first: states of the fault-free run."""

    known: Lumps
    drift: Array | None
    first: Estimates


@dataclass(frozen=True)
class PaperMethod:
    """The paper's method; window: samples of the moving average.

    For an ablation: filtered: False takes the readings themselves; mixing: see `SigmaMixedFilter`;
    noise: factor on the variance of a reading; the larger, the less the filter follows readings.
    """

    window: int = 7
    causal: bool = False
    centred: bool = False
    weighted: bool = False
    degrades: bool = True
    filtered: bool = True
    mixing: float = MIXING
    noise: float = 1.0

    name: ClassVar[str] = "paper"

    @property
    def filtering(self) -> tuple[float, ...]:
        """Settings that determine the states for a given record, model and drift."""
        return self.weighted, self.filtered, self.mixing

    @property
    def learning(self) -> tuple[float, ...]:
        """Settings that determine what is learnt."""
        return *self.filtering, self.noise, self.degrades

    def learn(
        self, healthy: Record, model: Lumps | None = None, states: Filtering | None = None
    ) -> Learnt:
        """Learn what is the same for every window and limit; this is the slow part.

        model: `lumps(healthy)`, where it is known; states: in place of `self.states`.
        """
        states = states or self.states
        known = lumps(healthy) if model is None else model
        known = known._replace(r=known.r * self.noise)
        first = states(healthy, known, None)
        drift = self._drift(healthy, first) if self.degrades else None
        return Learnt(known, drift, first if drift is None else states(healthy, known, drift))

    def states(self, record: Record, known: Lumps, drift: Array | None) -> Estimates:
        """See `Filtering`."""
        if self.filtered:
            return SigmaMixedFilter(self.weighted, self.mixing).run(record, known, drift)
        readings = filled(record.temperature, usual(record.temperature))
        return Estimates(readings, readings.mean(axis=2))

    def fit(
        self, healthy: Record, learnt: Learnt | None = None, states: Filtering | None = None
    ) -> Callable[[Record], Array]:
        """Learn from one fault-free run; returns a function from a record to (K,) statistics.

        A statistic is the largest share of its limit that any point has reached. learnt: result of
        `learn` by a method of the same `learning` on this run; states: in place of `self.states`.
        """
        filtered = states or self.states
        known, drift, first = learnt or self.learn(healthy, states=states)
        centre = first.state.mean(axis=0) if self.centred else np.zeros(first.state.shape[1:])
        limit = np.quantile(self._points(first, centre), LIMIT, axis=0)

        def score(record: Record) -> Array:
            points = self._points(filtered(record, known, drift), centre)
            return np.asarray((points / limit).max(axis=1))

        return score

    def _points(self, estimates: Estimates, centre: Array) -> Array:
        """(K, 3) MAISD of each point."""
        average = moving_average(estimates.state - centre, self.window, causal=self.causal)
        return maisd(average)

    def _drift(self, record: Record, estimates: Estimates) -> Array | None:
        """Drift (M, 3) K/s of the states less the motors' mean: Algorithm 2, steps 2 and 3.

        None if no state drifts.
        """
        t = (record.at - record.at[0]) * record.step_s
        beyond = estimates.state - estimates.state.mean(axis=1, keepdims=True)
        every = max(len(t) // 400, 1)
        out = np.zeros(beyond.shape[1:])
        for m, p in np.ndindex(*out.shape):
            y = beyond[::every, m, p]
            found = degradation.fit(y, t[::every])
            # A drift within two of its own standard errors counts as none.
            sure = abs(found.drift) > 2.0 * found.drift_sigma
            out[m, p] = found.drift if sure else 0.0
        return out if out.any() else None
