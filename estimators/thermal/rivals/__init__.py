"""Rivals of the thermal method: paper `thermal`, Table 2 (DPCA, DSFA, LSTM, JITL, EKF).

Every one learns from one fault-free run and gives one statistic per sample; whoever compares them
sets the alarm limit, by the same rule for all. None of them knows of motors being alike unless
its own docstring says so.
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
    """A way to detect thermal faults that is taught with healthy data alone."""

    @property
    def name(self) -> str:
        """Key in `RIVALS`."""
        ...

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. ValueError if it is too short to learn from."""
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
"""By time base, tuned on development trains as `bench.thermal_rivals` does it; the LSTM as its
docstring says, `FOLLOWING` as described."""
