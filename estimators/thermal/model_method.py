"""The product's thermal method: a calibrated model for each motor, hypotheses on what is left.

`heat` is identified on the first part of fault-free data, the residuals' spread on the rest: limits
from data that the fit has seen are too tight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from estimators.thermal import hypotheses, steps
from estimators.thermal.heat import drive, predict
from estimators.thermal.hypotheses import Belief, Pace, Spread, pace
from estimators.thermal.identify import first_readings, identify
from estimators.thermal.record import Record, spacing, split

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Calibrated:
    """A train's motors as fault-free data show them."""

    parameters: Array
    spread: Spread
    pace: Pace
    together: int
    noise: Array

    def residual(self, record: Record) -> Array:
        """(K, M, 3) K: readings less the model's."""
        return record.temperature - predict(self.parameters, drive(record), first_readings(record))

    def believe(self, record: Record) -> Belief:
        """Probabilities of every kind of fault; causal but for the record's mean signatures.

        Where samples come fast, those of the last whole block.
        """
        n, k = self.together, len(record.at)
        residual = self.residual(record)
        off = steps.offsets(residual, spacing(record))
        seen = hypotheses.Blocks(
            hypotheses.blocks(residual - off, n, None).middle,
            hypotheses.blocks(residual, n, self.noise).loose,
        )
        shapes = hypotheses.signatures(self.parameters, drive(record), first_readings(record))
        found = hypotheses.believe(seen, self.spread, shapes[n - 1 :: n], self.pace)
        if n == 1:
            return found
        last = (np.arange(k) + 1) // n - 1
        begun = last >= 0
        kind = np.where(begun[:, None, None], found.kind[last], 0.0)
        size = np.where(begun[:, None], found.size_k[last], 0.0)
        return hypotheses.with_steps(Belief(kind, size), off)

    def __call__(self, record: Record) -> Array:
        """(K,) log odds of a fault, 0 where none is as probable; the train's largest."""
        out: Array = self.believe(record).statistic.max(axis=1)
        return out


@dataclass(frozen=True)
class ModelMethod:
    """fit_share: of the fault-free samples, for the model's parameters."""

    fit_share: float = 0.7

    name: ClassVar[str] = "model"

    def fit(self, healthy: Record) -> Calibrated:
        """Calibrate on one fault-free record of at least some hundred samples."""
        return self.fit_runs(split(healthy, round(self.fit_share * len(healthy.at))))

    def fit_runs(self, runs: Sequence[Record]) -> Calibrated:
        """Calibrate on two or more fault-free runs: the last one is for the spread."""
        healthy, rest = runs[0], runs[-1]
        parameters = identify(runs[:-1])
        residual = rest.temperature - predict(parameters, drive(rest), first_readings(rest))
        found, together = pace(spacing(healthy))
        noise = hypotheses.single_noise(residual, together)
        middle = hypotheses.blocks(residual, together, None).middle
        known = hypotheses.spread(middle, found.learnt)
        return Calibrated(parameters, known, found, together, noise)
