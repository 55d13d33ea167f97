"""The product's thermal method: a calibrated model for each motor, hypotheses on what is left.

`heat` is identified on the first part of fault-free data, the residuals' spread on the rest: limits
from data that the fit has seen are too tight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from estimators.thermal import hypotheses
from estimators.thermal.heat import drive, predict
from estimators.thermal.hypotheses import Belief, Pace, Spread, pace
from estimators.thermal.identify import first_readings, identify
from estimators.thermal.record import Record, split

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Calibrated:
    """A train's motors as fault-free data show them."""

    parameters: Array
    spread: Spread
    pace: Pace

    def beside(self, record: Record) -> Array:
        """(K, M, 3) K: readings less the model's, less the other motors' median of that."""
        model = predict(self.parameters, drive(record), first_readings(record))
        return hypotheses.beside_peers(record.temperature - model)

    def believe(self, record: Record) -> Belief:
        """Probabilities of every kind of fault; causal but for the record's mean signatures."""
        shapes = hypotheses.signatures(self.parameters, drive(record), first_readings(record))
        return hypotheses.believe(self.beside(record), self.spread, shapes, self.pace)

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
        first, rest = split(healthy, round(self.fit_share * len(healthy.at)))
        parameters = identify([first])
        residual = rest.temperature - predict(parameters, drive(rest), first_readings(rest))
        spacing_s = float(np.median(np.diff(healthy.at))) * healthy.step_s
        found = pace(spacing_s)
        beside = hypotheses.beside_peers(residual)
        return Calibrated(parameters, hypotheses.spread(beside, found.learnt), found)
