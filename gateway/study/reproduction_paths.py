"""The cost of quantisation and of the bus: one experiment with several sources of the load.

Every path is sampled at the same instants, as by a live reader: each instant gets the last estimate
so far. If a path lacks an estimate of any drive, the instant is left out for all paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Ints
from gateway.io.whole_file import write_csv
from gateway.study import reproduction as table_1
from gateway.study.reproduction import METHODS, STATISTICS, Table
from gateway.study.reproduction_loads import rmse

INSTANT_NS: Final = 1_125_000
"""Nine periods of 125 us: every phase of frames of eight and of sixteen is met equally often."""
SETTLED: Final = 10
"""Ticks left out of a delay, because the gateway on a bus has to find the rotors first."""


class Way(NamedTuple):
    """How samples are taken.

    less: the way that differs in one thing only, "" for none; cost: that thing, as text.
    """

    name: str
    less: str
    cost: str


WAYS: Final = (
    Way("8 kHz", "", ""),
    Way("8 kHz, rounded", "8 kHz", "rounding as in FD frames"),
    Way("FD bus", "8 kHz, rounded", "the FD bus: frames of eight samples, stamps, start"),
    Way("2 ms", "8 kHz", "a sample of three currents every 2 ms, not of two every 125 us"),
    Way("2 ms, rounded", "2 ms", "rounding as in classic frames"),
    Way("classic bus", "2 ms, rounded", "the classic bus: two frames a sample, stamps, start"),
)
"""Without a bus the filter starts at the true state at t = 0; on a bus the gateway finds it."""


class Course(NamedTuple):
    """Load estimates of one way and filter.

    t_ns (K,): when they became available; load (K, N): Nm, NaN where not known.
    """

    way: str
    belief: str
    t_ns: Ints
    load: Array


class Seen(NamedTuple):
    """One path at the common instants: Table 1, root mean square error per drive (N,) Nm."""

    way: str
    belief: str
    table: Table
    rmse: Array


class Delay(NamedTuple):
    """Age of a bus's loads at its own ticks.

    age_ns: mean age of the samples without a bus that match them best; rest_nm: root mean square
    of the remaining difference.
    """

    way: str
    belief: str
    age_ns: float
    rest_nm: float


class Comparison(NamedTuple):
    """Comparison of all paths; first_ns: first common instant, instants: their number.

    known_from_ns: when a path first had the loads of all drives, by way and filter.
    """

    first_ns: int
    instants: int
    seen: list[Seen]
    delays: list[Delay]
    known_from_ns: dict[tuple[str, str], int]

    def of(self, way: str, belief: str) -> Seen:
        """The path of that way and filter."""
        return next(s for s in self.seen if (s.way, s.belief) == (way, belief))


def at(path: Course, instants: Ints) -> Array:
    """Loads (K, N): the last estimate at or before each instant; NaN before the first one."""
    k = np.searchsorted(path.t_ns, instants, side="right") - 1
    return np.where(k[:, None] >= 0, path.load[np.maximum(k, 0)], np.nan)


def compare(paths: Sequence[Course], truth: Course) -> Comparison:
    """Compare the paths at the instants at which all of them have the loads of all drives.

    Raises ValueError if there are too few such instants.
    """
    last = min(int(p.t_ns[-1]) for p in (*paths, truth))
    instants = np.arange(INSTANT_NS, last + 1, INSTANT_NS)
    loads = [at(p, instants) for p in paths]
    known = np.all([np.isfinite(load).all(axis=1) for load in loads], axis=0)
    if np.count_nonzero(known) < 2 * SETTLED:
        raise ValueError("the gateway hardly ever knew the loads of all drives")
    true = at(truth, instants)[known]
    seen = [
        Seen(p.way, p.belief, table_1.table(load[known]), rmse(load[known], true))
        for p, load in zip(paths, loads, strict=True)
    ]
    by_name = {(p.way, p.belief): p for p in paths}
    delays = [
        _delay(by_name[way.name, belief], by_name[way.less, belief])
        for way in WAYS
        for belief in dict.fromkeys(p.belief for p in paths)
        if way.name.endswith("bus")
    ]
    starts = {
        (p.way, p.belief): int(p.t_ns[np.argmax(np.isfinite(p.load).all(axis=1))]) for p in paths
    }
    first = int(instants[np.argmax(known)])
    return Comparison(first, int(np.count_nonzero(known)), seen, delays, starts)


def _delay(bus: Course, without: Course) -> Delay:
    """Find the age with the smallest difference, below 8 ms; the start is left out."""
    known = np.flatnonzero(np.isfinite(bus.load).all(axis=1))[SETTLED:]
    tries = int(8_000_000 // (without.t_ns[1] - without.t_ns[0]))
    known = known[(bus.t_ns[known] >= without.t_ns[tries]) & (bus.t_ns[known] <= without.t_ns[-1])]
    t_ns, load = bus.t_ns[known], bus.load[known]
    newest = np.searchsorted(without.t_ns, t_ns, side="right") - 1
    best = Delay(bus.way, bus.belief, 0.0, np.inf)
    for back in range(tries):
        k = newest - back
        rest = float(np.sqrt(np.mean((load - without.load[k]) ** 2)))
        if rest < best.rest_nm:
            age = float(np.mean(t_ns - without.t_ns[k]))
            best = best._replace(age_ns=age, rest_nm=rest)
    return best


def write_paths(path: Path, comparison: Comparison) -> None:
    """Write `table1_paths.csv`: Table 1 of every path, a row per number. Raises OSError."""
    rows = [
        (seen.way, seen.belief, method, d, name, f"{round(value, 4) + 0.0:.4f}")
        for seen in comparison.seen
        for method, drives in zip(METHODS.values(), seen.table.value.tolist(), strict=True)
        for d, row in enumerate(drives, 1)
        for name, value in zip(STATISTICS, row, strict=True)
    ]
    write_csv(path, [("path", "filter", "method", "drive", "statistic", "value_nm"), *rows])
