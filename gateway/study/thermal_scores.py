"""Scores of thermal detection: per sample against the injection interval, and per fault.

Strict: every sample from the fault's begin to its end is faulty. Graced: the onset is left out
until the true effect passes 2 K, and the recovery until it is below 1 K, because no method can
decide there. Numbers in, numbers out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags, Ints
from gateway.reports.scoring import stretches

SHOWN_K: Final = 2.0
GONE_K: Final = 1.0
PRINTED_FPR: Final = 0.0275
"""False positive rate of paper `thermal`, Table 2, at which the methods' misses are compared."""
DAY_S: Final = 86_400.0


class Truth(NamedTuple):
    """Truth of one run: `faulty` (K,): a fault is injected; effect (K,) K: largest at any point.

    motor: -1 for a healthy run; begin: sample; sample_s: spacing; loose: the fault acts in bursts.
    """

    faulty: Flags
    effect: Array
    motor: int
    begin: int
    sample_s: float
    loose: bool = False


class Diagnosis(NamedTuple):
    """Diagnosis beside the alarm: named motor (K,), and whether the kind is right (K,)."""

    motor: Ints
    kind_right: Flags


class Score(NamedTuple):
    """Shares of samples, except found (0 or 1), delay_s, seconds, false episodes per day."""

    accuracy: float
    fpr: float
    fnr: float
    graced_fpr: float
    graced_fnr: float
    best_accuracy: float
    best_fpr: float
    best_fnr: float
    fnr_at_printed: float
    found: float
    delay_s: float
    motor_right: float
    kind_right: float
    episodes: float
    seconds: float


def score_alarms(
    statistic: Array, limit: float, truth: Truth, diagnosis: Diagnosis | None = None,
    seconds: float = 0.0,
) -> Score:  # fmt: skip
    """Score one run. A NaN of the statistic is no alarm; a share of no samples is NaN."""
    finite = np.where(np.isfinite(statistic), statistic, -np.inf)
    alarm = finite > limit
    faulty = truth.faulty
    hidden = faulty & (truth.effect < SHOWN_K) & (not truth.loose)
    judged = ~hidden & ~(~faulty & (truth.effect > GONE_K))
    best_accuracy, best_fpr, best_fnr = _best(finite, faulty)
    healthy_days = np.count_nonzero(~faulty) * truth.sample_s / DAY_S
    hit = np.flatnonzero(alarm & faulty)
    return Score(
        accuracy=_share(alarm == faulty),
        fpr=_share(alarm[~faulty]),
        fnr=_share(~alarm[faulty]),
        graced_fpr=_share(alarm[~faulty & judged]),
        graced_fnr=_share(~alarm[faulty & judged]),
        best_accuracy=best_accuracy,
        best_fpr=best_fpr,
        best_fnr=best_fnr,
        fnr_at_printed=_at(finite, faulty, PRINTED_FPR),
        found=float(len(hit) > 0) if faulty.any() else math.nan,
        delay_s=(float(hit[0]) - truth.begin) * truth.sample_s if len(hit) else math.nan,
        motor_right=_share(diagnosis.motor[hit] == truth.motor) if diagnosis else math.nan,
        kind_right=_share(diagnosis.kind_right[hit]) if diagnosis else math.nan,
        episodes=len(stretches(alarm & ~faulty)) / healthy_days,
        seconds=seconds,
    )


def mean(scores: Iterable[Score]) -> Score:
    """Mean of every figure over the runs that have it; for the delay, the median."""
    rows = np.array(list(scores), dtype=float)
    with np.errstate(all="ignore"):
        means = [_over(rows[:, k], np.mean) for k in range(rows.shape[1])]
    delay = Score._fields.index("delay_s")
    means[delay] = _over(rows[:, delay], np.median)
    return Score(*means)


def spread(scores: Iterable[Score]) -> Score:
    """Standard deviation of every figure over the runs that have it."""
    rows = np.array(list(scores), dtype=float)
    return Score(*(_over(rows[:, k], np.std) for k in range(rows.shape[1])))


def _over(values: Array, what: object) -> float:
    known = values[np.isfinite(values)]
    return float(what(known)) if len(known) else math.nan  # type: ignore[operator]


def _share(flags: Flags) -> float:
    return float(np.mean(flags)) if len(flags) else math.nan


def _best(statistic: Array, faulty: Flags) -> tuple[float, float, float]:
    """Accuracy, FPR and FNR with the limit that gives the best accuracy."""
    order = np.argsort(-statistic, kind="stable")
    hits = np.concatenate([[0], np.cumsum(faulty[order])])
    false = np.arange(len(order) + 1) - hits
    ill, well = hits[-1], len(faulty) - hits[-1]
    accuracy = (hits + well - false) / len(faulty)
    # A limit cannot separate equal values.
    ranked = statistic[order]
    parted = np.concatenate([[True], ranked[1:] < ranked[:-1], [True]])
    k = int(np.argmax(np.where(parted, accuracy, -1.0)))
    return (
        float(accuracy[k]),
        float(false[k]) / well if well else math.nan,
        1.0 - float(hits[k]) / ill if ill else math.nan,
    )


def _at(statistic: Array, faulty: Flags, fpr: float) -> float:
    """FNR with the limit that at most the share `fpr` of the healthy samples exceeds."""
    if not faulty.any() or faulty.all():
        return math.nan
    healthy = np.sort(statistic[~faulty])
    limit = healthy[min(math.ceil((1.0 - fpr) * len(healthy)), len(healthy)) - 1]
    return _share(statistic[faulty] <= limit)


COLUMNS: Final = (
    "method", "kind", "runs", "accuracy %", "sd", "FPR %", "FNR %", "graced FPR %", "graced FNR %",
    "best accuracy %", "best FPR %", "best FNR %", "FNR % at FPR 2.75 %", "found", "median delay",
    "motor %", "class %", "false episodes / day", "s",
)  # fmt: skip


def cells(method: str, kind: str, scores: Sequence[Score]) -> list[str]:
    """One line of the table, in the order of `COLUMNS`; a dash where there is no number."""
    m, sd = mean(scores), spread(scores)
    percent = [
        m.accuracy, sd.accuracy, m.fpr, m.fnr, m.graced_fpr, m.graced_fnr, m.best_accuracy,
        m.best_fpr, m.best_fnr, m.fnr_at_printed,
    ]  # fmt: skip
    count = sum(s.found == 1.0 for s in scores)
    return [
        method,
        kind,
        str(len(scores)),
        *(_text(100.0 * value, 1) for value in percent),
        f"{count}" if any(math.isfinite(s.found) for s in scores) else "-",
        _time(m.delay_s),
        _text(100.0 * m.motor_right, 0),
        _text(100.0 * m.kind_right, 0),
        _text(m.episodes, 2),
        _text(m.seconds, 2),
    ]


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _time(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "-"
    return f"{seconds:.0f} s" if seconds < 3600.0 else f"{seconds / 3600.0:.1f} h"


def table_of(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
