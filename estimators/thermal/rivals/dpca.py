"""Dynamic principal component analysis (Ku, Storer, Georgakis 1995): paper `thermal`, Table 2.

A row is the variables of the sample and of `lags` before it. T^2 is the distance within the
components kept, SPE the distance from them; an alarm by either counts.

With the view "others" it exploits that the motors are alike.
Tried on seeds 0, 2 .. 8: four views, 0 to 2 lags, 70 to 99 % of variance, means of 0 to 10 % of a
run; differences to the other motors won by far (mean AUC 0.56 -> 0.88 at 1 Hz), the rest little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.record import Record, features

Scorer = Callable[[Record], Array]
"""(K,) statistic >= 0 per sample, larger = more suspicious, from samples up to it; NaN if early."""


@dataclass(frozen=True)
class Either:
    """Scorer by the larger of two statistics. each: both (K, 2), relative to the fit's limits."""

    names: tuple[str, str]
    each: Scorer

    def __call__(self, record: Record) -> Array:
        """The larger statistic (K,)."""
        larger: Array = self.each(record).max(axis=1)
        return larger


@dataclass(frozen=True)
class Dpca:
    """Tuning of dynamic PCA.

    lags: samples before the present one; kept: share of variance in the components; window:
    share of the run's samples over which the rows are averaged; view: see `View`.
    """

    lags: int = 2
    kept: float = 0.9
    window: float = 0.02
    view: str = "others"
    name: str = "dpca"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. Raises ValueError if it is too short for the lags."""
        from sklearn.decomposition import PCA

        view = View.of(healthy, self.view)
        window = span(healthy, self.window)
        rows = view.rows(healthy, window, self.lags)[self.lags :]
        if len(rows) < 2:
            raise ValueError(f"{len(healthy.at)} samples are too few for {self.lags} lags")
        pca = PCA(n_components=self.kept, svd_solver="full").fit(rows)
        power = np.maximum(pca.explained_variance_, TINY)

        def statistics(rows: Array) -> Array:
            scores = pca.transform(rows)
            rest = rows - pca.inverse_transform(scores)
            return np.stack([(scores**2 / power).sum(axis=1), (rest**2).sum(axis=1)], axis=1)

        return view.scorer(("T²", "SPE"), statistics, rows, window, self.lags)


TINY = 1e-9


class View(NamedTuple):
    """How a record becomes standardised variables: `kind` and the fit run's statistics.

    kind: "absolute", the temperatures in degC and `features`; "rise", the temperatures less the
    ambient, and `features` without it (a run in another season is then no fault); "others", as
    "rise", and of every temperature its difference to the median of the other motors'; "between",
    these differences and `features`, no temperatures.
    start: (M, 3) degC before a channel's first reading; centre, scale: (V,) of the variables.
    """

    kind: str
    start: Array
    centre: Array
    scale: Array

    @classmethod
    def of(cls, healthy: Record, kind: str) -> View:
        """Fit to a fault-free run. Raises ValueError for an unknown kind, or without samples."""
        if kind not in KINDS:
            raise ValueError(f"no view {kind!r}; there are {', '.join(KINDS)}")
        if not len(healthy.at):
            raise ValueError("no samples to learn from")
        start = usual(healthy.temperature)
        raw = _raw(healthy, kind, start)
        return cls(kind, start, raw.mean(axis=0), np.maximum(raw.std(axis=0), 1e-3))

    def see(self, record: Record) -> Array:
        """(K, V) standardised variables, finite."""
        return (_raw(record, self.kind, self.start) - self.centre) / self.scale

    def rows(self, record: Record, window: int, lags: int) -> Array:
        """(K, (lags + 1) V) of `see`, averaged over `window`; the first `lags` are meaningless."""
        return lagged(moving(self.see(record), window), lags)

    def scorer(
        self, names: tuple[str, str], statistics: Callable[[Array], Array], healthy: Array,
        window: int, lags: int,
    ) -> Either:  # fmt: skip
        """Scorer by two statistics (K, 2) of rows, relative to their limits on rows `healthy`."""
        limits = quantiles(statistics(healthy))

        def each(record: Record) -> Array:
            seen = self.rows(record, window, lags)
            out = np.full((len(seen), 2), np.nan)
            out[lags:] = statistics(seen[lags:]) / limits
            return out

        return Either(names, each)


KINDS = ("absolute", "rise", "others", "between")


def _raw(record: Record, kind: str, start: Array) -> Array:
    temperature = filled(record.temperature, start)
    known = features(record)
    if kind != "absolute":
        temperature = temperature - known[:, :1, None]
        known = known[:, 1:]
    columns = [known]
    if kind != "between" or record.motors == 1:
        columns.append(temperature.reshape(len(temperature), -1))
    if kind in ("others", "between") and record.motors > 1:
        columns.append(against_others(temperature).reshape(len(temperature), -1))
    return np.concatenate(columns, axis=1)


def usual(temperature: Array) -> Array:
    """Mean of each channel's readings, (M, 3) or (N,); without any: of all channels, or 0."""
    known = np.isfinite(temperature)
    count = known.sum(axis=0)
    total = np.where(known, temperature, 0.0).sum(axis=0)
    every = float(total.sum() / max(int(count.sum()), 1))
    mean: Array = np.where(count > 0, total / np.maximum(count, 1), every)
    return mean


def filled(temperature: Array, start: Array) -> Array:
    """(K, M, 3) with each missing reading replaced by the last known one, at first `start`."""
    last = np.where(np.isfinite(temperature), np.arange(1, len(temperature) + 1)[:, None, None], 0)
    last = np.maximum.accumulate(last, axis=0)
    padded = np.concatenate([start[None], temperature])
    out: Array = np.take_along_axis(padded, last, axis=0)
    return out


def against_others(values: Array) -> Array:
    """(K, M, P) each motor's value less the median of the others' (M > 1)."""
    motors = range(values.shape[1])
    others = [np.median(np.delete(values, m, axis=1), axis=1) for m in motors]
    return values - np.stack(others, axis=1)


def span(record: Record, share: float) -> int:
    """Samples in a share of a run, at least one."""
    return max(round(share * len(record.at)), 1)


def moving(values: Array, window: int) -> Array:
    """(K, ...) means of the last `window` values (of fewer at the start)."""
    total = np.cumsum(values, axis=0)
    total[window:] = total[window:] - total[:-window]
    count = np.minimum(np.arange(1, len(values) + 1), window)
    out: Array = total / count.reshape(-1, *[1] * (values.ndim - 1))
    return out


def lagged(values: Array, lags: int) -> Array:
    """(K, (lags + 1) V): every row with those before it; the first `lags` rows are meaningless."""
    return np.concatenate([np.roll(values, lag, axis=0) for lag in range(lags + 1)], axis=1)


def quantiles(statistics: Array) -> Array:
    """(S,) 99 % quantile of each column, never 0."""
    limits: Array = np.maximum(np.quantile(statistics, 0.99, axis=0), TINY)
    return limits
