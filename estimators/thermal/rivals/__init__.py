"""Rivals of the thermal method: paper `thermal`, Table 2 (DPCA, DSFA, LSTM, JITL, EKF).

Each one learns from one fault-free run and gives one statistic per sample; the comparison sets the
alarm limit, by the same rule for all. A rival exploits that the motors are alike only if its
own docstring states it.
"""

from __future__ import annotations

from typing import Final, Protocol

from estimators.thermal.record import Record
from estimators.thermal.rivals.dpca import Dpca, Scorer
from estimators.thermal.rivals.dsfa import Dsfa
from estimators.thermal.rivals.ekf import FOLLOWING, EkfResidual
from estimators.thermal.rivals.jitl import Jitl
from estimators.thermal.rivals.lstm import Lstm


class Method(Protocol):
    """A method to detect thermal faults that learns from healthy data alone."""

    @property
    def name(self) -> str:
        """Key in `RIVALS`."""
        ...

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. Raises ValueError if the run is too short."""
        ...


def _named(*methods: Method) -> dict[str, Method]:
    return {method.name: method for method in methods}


RIVALS: Final[dict[str, dict[str, Method]]] = {
    "days": _named(
        Dpca(), Dsfa(lags=1, width=7), Lstm(), Jitl(neighbours=30, ridge=1.0, window=0.005),
        EkfResidual(window=0.0), FOLLOWING,
    ),
    "bench": _named(
        Dpca(lags=0, window=0.002, view="between"), Dsfa(slow=0.75, window=0.002), Lstm(),
        Jitl(ridge=100.0, window=0.002), EkfResidual(), FOLLOWING,
    ),
}  # fmt: skip
"""By time base, tuned on development trains as in `bench.thermal_rivals`; the LSTM is tuned as its
docstring states, `FOLLOWING` is as usually described."""
