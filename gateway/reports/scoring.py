"""All rules of scoring: whether a flag was raised, with which delay, and whether it was false.

`first` looks for a state in the flag frames of a run, `judge` matches events of the truth with
intervals of flags, `score_flag` counts flag frames against the truth.

F1 leaves out `EDGE_S` around each edge of the truth and the first `SKIP_S`; unknown counts as
not raised. The delay is the time from the true onset to the stamp of the first `AdhesionLost`.

A loss counts from a depth of `SHALLOW` on. While it is shallower for longer than an edge (a slow
onset, a rail that carries nearly all), frames are neither right nor wrong. A false alarm is a
series of `AdhesionLost` that touches no loss, with an edge added before and after each loss.

If the adhesion is back, but the drive's own limiter still reduces its torque, no measurement shows
that it is back. Frames of `AdhesionLost` at that time count as false, and also separately, so that
F1 can be given without them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from itertools import islice
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array, Flags
from dbc.frame import Nanos
from gateway.core.codes import Flag
from gateway.reports.intervals import Interval
from gateway.reports.truth import Event, Row

EDGE_S: Final = 0.03
"""No flag is false within this time after an event; no frame counts so near to an edge of it."""
SKIP_S: Final = 0.5
"""Time at the start in which no frame counts."""
SHALLOW: Final = 0.2 - 1e-9
"""Depth of a loss, as share of the demand, below which it need not be found."""
DEEP: Final = 0.5
LATE_S: Final = 0.1
"""A flag that is still `Adhering` for longer than this after the onset of a loss is dangerous."""
ABRUPT_S: Final = 0.02
"""A loss is abrupt if half of the demand is lost within this time after its onset."""
GRACE_S: Final = 5e-7
"""Tolerance of times: stamps and times of the truth are decimal numbers of the same grid."""


class Judged(NamedTuple):
    """An event, the interval of its flag that detects it, and its delay; None if none does."""

    event: Event
    by: Interval | None
    delay_ms: float | None


def first(seen: Sequence[tuple[Nanos, Flag]], wanted: Flag, from_ns: Nanos) -> Nanos | None:
    """Stamp of the first frame of a flag from `from_ns` on with this state; None without one."""
    begin = bisect_left(seen, from_ns, key=itemgetter(0))
    return next((t for t, state in islice(seen, begin, None) if state is wanted), None)


def judge(
    events: Sequence[Event], intervals: Sequence[Interval], start_ns: int
) -> tuple[list[Judged], set[Interval]]:
    """Every event with the delay of its flag, and the bad intervals that no event explains.

    An event is found by the first bad interval of its flag that begins in it, or holds already.
    start_ns: time 0 of the report. Pass only intervals of drives with a known truth.
    """
    bad = [i for i in intervals if i.bad]
    false = set(bad)
    judged = []
    for event in events:
        delay: float | None = None
        by: Interval | None = None
        for i in bad:
            if (i.node, i.flag) != (event.node, event.flag):
                continue
            begin, end = (i.start_ns - start_ns) / 1e9, (i.end_ns - start_ns) / 1e9
            if begin <= event.end_s + EDGE_S and end >= event.start_s:
                false.discard(i)
            if delay is None and begin <= event.end_s and end > event.start_s:
                delay, by = max(begin - event.start_s, 0.0) * 1e3, i
        judged.append(Judged(event, by, delay))
    return judged, false


def summary_table(judged: Sequence[Judged], nodes: Sequence[int]) -> str:
    """Table of the losses of each drive: number, found, median and longest delay."""
    lines = ["drive  losses  found  median delay / ms  worst / ms"]
    for node in nodes:
        mine = [j for j in judged if j.event.node == node]
        delays = [j.delay_ms for j in mine if j.delay_ms is not None]
        middle, worst = (f"{quantile(delays, q):.0f}" if delays else "-" for q in (0.5, 1.0))
        lines.append(f"{node:5}  {len(mine):6}  {len(delays):5}  {middle:>17}  {worst:>10}")
    return "\n".join(lines)


class Score(NamedTuple):
    """Counts over drives and flag frames; `plus` pools runs.

    good, unknown: healthy frames with `Adhering` and with `Unknown`; healthy: all healthy frames
    that count. delays_ms: of the losses found; missed: number of losses without a flag until they
    end. abrupt_ms: delays of abrupt losses. alarms: false alarms; train_s: healthy time, mean of
    the drives. dangerous: frames with `Adhering` more than `LATE_S` after the onset of a loss. cut:
    frames of false_positive of a drive that cuts its own torque.
    """

    true_positive: int = 0
    false_positive: int = 0
    false_negative: int = 0
    good: int = 0
    healthy: int = 0
    delays_ms: tuple[float, ...] = ()
    missed: int = 0
    unknown: int = 0
    abrupt_ms: tuple[float, ...] = ()
    alarms: int = 0
    train_s: float = 0.0
    dangerous: int = 0
    cut: int = 0

    def plus(self, other: Score) -> Score:
        """The score of both runs pooled."""
        pairs: Iterable[tuple[Any, Any]] = zip(self, other, strict=True)
        return Score(*(mine + its for mine, its in pairs))

    @property
    def losses(self) -> int:
        """Number of losses."""
        return len(self.delays_ms) + self.missed

    @property
    def f1(self) -> float:
        """2 TP / (2 TP + FP + FN); 1 if no adhesion was lost and no flag raised."""
        bad = self.false_positive + self.false_negative
        return _share(2 * self.true_positive, 2 * self.true_positive + bad)

    @property
    def uncut_f1(self) -> float:
        """F1 without false frames in which a drive on a good rail cuts its own torque."""
        return self._replace(false_positive=self.false_positive - self.cut).f1

    @property
    def precision(self) -> float:
        """TP / (TP + FP); 1 if no flag was raised."""
        return _share(self.true_positive, self.true_positive + self.false_positive)

    @property
    def recall(self) -> float:
        """TP / (TP + FN); 1 if no adhesion was lost."""
        return _share(self.true_positive, self.true_positive + self.false_negative)

    @property
    def good_share(self) -> float:
        """Share of healthy flag frames with `Adhering`; 1 if there are none."""
        return _share(self.good, self.healthy)

    @property
    def false_share(self) -> float:
        """Share of healthy flag frames with `AdhesionLost`; 0 if there are none."""
        return self.false_positive / self.healthy if self.healthy else 0.0

    @property
    def unknown_share(self) -> float:
        """Share of healthy flag frames with `Unknown`; 0 if there are none."""
        return self.unknown / self.healthy if self.healthy else 0.0

    @property
    def dangerous_share(self) -> float:
        """Share of the flag frames during losses that are `dangerous`; 0 if there are none."""
        lost = self.true_positive + self.false_negative
        return self.dangerous / lost if lost else 0.0

    @property
    def alarms_per_hour(self) -> float:
        """False alarms per healthy hour of the train; 0 if there is no healthy time."""
        return 3600.0 * self.alarms / self.train_s if self.train_s else 0.0

    @property
    def median_delay_ms(self) -> float:
        """Median delay of the losses found; infinite if there are none."""
        return quantile(self.delays_ms, 0.5)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


def quantile(values: Sequence[float], share: float) -> float:
    """Quantile of the values, the upper of two neighbours; infinite without values."""
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else float("inf")


class Truth(NamedTuple):
    """True state of one drive at K instants, each (K,): lost; depth 0..1; cuts its own torque."""

    t_s: Array
    lost: Flags
    depth: Array
    cuts: Flags

    def at(self, t_s: Array) -> NDArray[np.int64]:
        """(T,) row valid at times (T,): the last one not later; -1 before the first."""
        return np.searchsorted(self.t_s, t_s + GRACE_S, side="right") - 1

    def edges(self) -> Array:
        """Times at which adhesion is lost or back."""
        return self.t_s[_changes(self.lost)]

    def since_onset_s(self, t_s: Array) -> Array:
        """(T,) time since the last onset of a loss; infinite before the first."""
        onsets = np.array([-np.inf, *(self.t_s[first] for first, _ in self.losses())])
        out: Array = t_s - onsets[np.searchsorted(onsets, t_s + GRACE_S, side="right") - 1]
        return out

    def losses(self) -> list[tuple[int, int]]:
        """Rows (first, last + 1) of each interval of lost adhesion."""
        return stretches(self.lost)

    def counted(self, t_s: Array) -> Flags:
        """(T,) which of these times count for the score."""
        edges = self.edges()
        shallow = self.lost & (self.depth < SHALLOW)
        for first, last in stretches(shallow):
            end_s = self.t_s[last] if last < len(self.t_s) else np.inf
            if end_s - self.t_s[first] > EDGE_S + GRACE_S:
                edges = np.append(edges, [self.t_s[first], end_s])
            else:
                shallow[first:last] = False
        row = self.at(t_s)
        out: Flags = (t_s >= SKIP_S) & ~(shallow[row] & (row >= 0))
        for edge in edges[np.isfinite(edges)]:
            out &= ~(np.abs(t_s - edge) < EDGE_S - GRACE_S)
        return out


def truth_of(rows: Iterable[Row], node: int) -> Truth:
    """Truth of one drive; rows without `depth` count as depth 1, rows without `cut` as not cut."""
    mine = [row for row in rows if row.drive == node]
    lost = np.array([bool(row.lost) for row in mine], dtype=np.bool_)
    depth = np.array([getattr(row, "depth", 1.0) for row in mine], dtype=np.float64)
    cuts = np.array([getattr(row, "cut", 0) for row in mine], dtype=np.bool_)
    return Truth(np.array([row.t_s for row in mine], dtype=np.float64), lost, depth, cuts)


def everyone(truths: Sequence[Truth]) -> Truth:
    """Truth of the train: lost (or cut) while every drive is, with the least depth of all."""
    lost = np.logical_and.reduce([truth.lost for truth in truths])
    depth = np.minimum.reduce([truth.depth for truth in truths])
    cuts = np.logical_and.reduce([truth.cuts for truth in truths])
    return Truth(truths[0].t_s, lost, depth, cuts)


def score_flag(truth: Truth, t_s: Array, flag: NDArray[np.int64]) -> Score:
    """Score the values (T,) of one flag, a `Flag` each, from the flag frames at times (T,)."""
    counted = truth.counted(t_s)
    row = truth.at(t_s)
    lost = truth.lost[row] & (row >= 0)
    raised = flag == Flag.BAD
    healthy = counted & ~lost
    late = counted & lost & (truth.since_onset_s(t_s) > LATE_S + GRACE_S)
    every_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    score = Score(
        true_positive=int(np.count_nonzero(counted & lost & raised)),
        false_positive=int(np.count_nonzero(healthy & raised)),
        false_negative=int(np.count_nonzero(counted & lost & ~raised)),
        good=int(np.count_nonzero(healthy & (flag == Flag.GOOD))),
        healthy=int(np.count_nonzero(healthy)),
        unknown=int(np.count_nonzero(healthy & (flag == Flag.UNKNOWN))),
        alarms=_alarms(truth, t_s, raised),
        train_s=every_s * int(np.count_nonzero(healthy)),
        dangerous=int(np.count_nonzero(late & (flag == Flag.GOOD))),
        cut=int(np.count_nonzero(healthy & raised & truth.cuts[row])),
    )
    return score.plus(_delays(truth, t_s[raised]))


def _alarms(truth: Truth, t_s: Array, raised: Flags) -> int:
    """Number of series of raised flags that touch no loss."""
    near = truth.lost[truth.at(t_s)] & (truth.at(t_s) >= 0)
    for edge in truth.edges():
        near = near | (np.abs(t_s - edge) < EDGE_S - GRACE_S)
    return sum(not near[a:b].any() and bool(t_s[b - 1] >= SKIP_S) for a, b in stretches(raised))


def _delays(truth: Truth, raised_s: Array) -> Score:
    found, abrupt, missed = [], [], 0
    for first, last in truth.losses():
        start_s = float(truth.t_s[first])
        end_s = float(truth.t_s[min(last, len(truth.t_s) - 1)])
        if truth.depth[first:last].max() < SHALLOW:
            continue
        inside = raised_s[(raised_s >= start_s - GRACE_S) & (raised_s < end_s - GRACE_S)]
        if not len(inside):
            missed += 1
            continue
        found.append((float(inside[0]) - start_s) * 1e3)
        early = truth.t_s[first:last] <= start_s + ABRUPT_S + GRACE_S
        if truth.depth[first:last][early].max() >= DEEP:
            abrupt.append(found[-1])
    return Score(delays_ms=tuple(found), abrupt_ms=tuple(abrupt), missed=missed)


def _changes(values: Flags) -> NDArray[np.int64]:
    """Rows at which a flag differs from the row before; before the first it is False."""
    return np.flatnonzero(np.diff(values, prepend=False))


def stretches(values: Flags) -> list[tuple[int, int]]:
    """Rows (first, last + 1) of each series of raised flags."""
    edges = _changes(np.append(values, np.False_)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
