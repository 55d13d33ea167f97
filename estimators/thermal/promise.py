"""A stated rate of false alarms, and the limit of the monitor that keeps it.

The limit comes from the largest log odds of a fault in every hour of a fault-free record that was
not used for learning: a tolerance limit (`estimators.tolerance`), whatever the model. With fewer
hours than that needs, the limit is extrapolated, and nothing is promised: above even odds, odds
that are e times as large are assumed to be e times as rare, which holds for the posterior odds of
a correct model (Ville's inequality).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.monitor import RAISE, ThermalMonitor, followed
from estimators.thermal.record import Record, spacing
from estimators.tolerance import BROKEN, STORED, Promise, least_rate, needed, order_of

HOUR_S: Final = 3600.0
CERTAIN: Final = 30.0
"""Log odds that no limit exceeds: a sensor that has stepped is always reported."""


class Hours(NamedTuple):
    """Fault-free hours: number, and the log odds of the worst (at most `STORED`), descending."""

    number: int
    largest: tuple[float, ...]


def hourly(monitor: ThermalMonitor, record: Record) -> Array:
    """(H,) largest log odds of a fault of any motor in each whole hour of a fault-free record.

    monitor: a new one. It is set to report nothing, because a report (`held`) would change the
    odds.
    """
    monitor.config["raise_probability"] = 1.0
    judged = monitor.known_motors["unexplained"] == 0
    per_hour = HOUR_S / spacing(record)
    hours = int(len(record.at) / per_hour)
    out = np.full(hours, -CERTAIN)
    for k, complete in enumerate(followed(monitor, record)):
        hour = int(k / per_hour)
        if complete and hour < hours:
            p = np.where(judged, monitor.motors["fault_probability"], 0.0)
            stepped = (monitor.offsets[judged] != 0.0).any()
            out[hour] = max(out[hour], CERTAIN if stepped else log_odds(float(p.max())))
    return out


def log_odds(p: float) -> float:
    """Log odds of a probability, limited to -`CERTAIN` .. `CERTAIN`."""
    least = 1.0 / (1.0 + math.exp(CERTAIN))
    p = min(max(p, least), 1.0 - least)
    return math.log(p / (1.0 - p))


def hours_of(peaks: Array) -> Hours:
    """`Hours` of results of `hourly`, from one record or several."""
    return Hours(len(peaks), tuple(np.sort(peaks)[::-1][:STORED].tolist()))


def promise_of(hours: Hours, rate: float) -> Promise:
    """Promise for `rate` false alarms in 1000 h; its limit: of a fault's probability.

    hours: at least one.
    """
    share = -math.expm1(-rate / 1000.0)
    n, k = hours.number, order_of(hours.number, len(hours.largest), share)
    seen = -math.expm1(math.log(BROKEN) / n)
    odds = hours.largest[k - 1] if k else max(hours.largest[0], 0.0) + math.log(seen / share)
    limit = max(1.0 / (1.0 + math.exp(-min(odds, CERTAIN))), RAISE)
    promised = k > 0 and odds < CERTAIN
    return Promise(
        rate, limit, promised, n, needed(share), least_rate(n, 1000), "hours",
        f"limit {limit:.6f}{'' if promised else ' extrapolated'}",
        f"in too many of the {n} fault-free hours a fault seemed certain",
    )  # fmt: skip
