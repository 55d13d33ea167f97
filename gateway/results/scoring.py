"""How good the adhesion flags are: judged per drive and flag frame, read from the wire.

F1 leaves out `edge_s` around each edge of the truth and the first `skip_s`; unknown counts as
not raised. Delay runs from the truth's onset to the time stamp of the first `AdhesionLost`.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gateway.health import Flag
from gateway.results.delays import Loss, TruthRow, injected
from gateway.results.expect import FlagTrack


class Score(NamedTuple):
    """Counts over drives and flag frames; add scores to pool runs.

    good: healthy frames that say `Adhering`; healthy: all healthy frames counted.
    delays_ms: of the losses found; missed: losses without a flag until they end.
    """

    true_positive: int = 0
    false_positive: int = 0
    false_negative: int = 0
    good: int = 0
    healthy: int = 0
    delays_ms: tuple[float, ...] = ()
    missed: int = 0

    def plus(self, other: Score) -> Score:
        """Both runs pooled."""
        return Score(
            self.true_positive + other.true_positive,
            self.false_positive + other.false_positive,
            self.false_negative + other.false_negative,
            self.good + other.good,
            self.healthy + other.healthy,
            self.delays_ms + other.delays_ms,
            self.missed + other.missed,
        )

    @property
    def f1(self) -> float:
        """2 TP / (2 TP + FP + FN); 1 where nothing was lost and nothing raised."""
        bad = self.false_positive + self.false_negative
        total = 2 * self.true_positive + bad
        return 2 * self.true_positive / total if total else 1.0

    @property
    def good_share(self) -> float:
        """Share of healthy flag frames that say `Adhering`."""
        return self.good / self.healthy if self.healthy else 1.0

    @property
    def median_delay_ms(self) -> float:
        """Median over the losses found; infinite if none was."""
        ordered = sorted(self.delays_ms)
        return ordered[len(ordered) // 2] if ordered else float("inf")


def score_run(
    truth: Iterable[TruthRow],
    track: FlagTrack,
    nodes: Sequence[int],
    start_ns: int = 0,
    edge_s: float = 0.03,
    skip_s: float = 0.5,
) -> Score:
    """Score one run; `truth` and the flag frames share the time base, from `start_ns`."""
    losses = injected(truth)
    total = Score()
    for node in nodes:
        mine = [loss for loss in losses if loss.drive == node]
        seen = [((t - start_ns) / 1e9, f) for t, f in track.seen.get(("adhesion", node), [])]
        total = total.plus(_frames(mine, seen, edge_s, skip_s)).plus(_delays(mine, seen))
    return total


def _frames(
    losses: Sequence[Loss], seen: Sequence[tuple[float, Flag]], edge_s: float, skip_s: float
) -> Score:
    edges = sorted(t for loss in losses for t in (loss.start_s, loss.end_s))
    tp = fp = fn = good = healthy = 0
    for t_s, flag in seen:
        at = bisect.bisect(edges, t_s)
        near = [abs(t_s - e) for e in edges[max(0, at - 1) : at + 1]]
        if t_s < skip_s or (near and min(near) < edge_s):
            continue
        lost = any(loss.start_s <= t_s < loss.end_s for loss in losses)
        raised = flag is Flag.BAD
        tp += lost and raised
        fp += raised and not lost
        fn += lost and not raised
        healthy += not lost
        good += not lost and flag is Flag.GOOD
    return Score(tp, fp, fn, good, healthy)


def _delays(losses: Sequence[Loss], seen: Sequence[tuple[float, Flag]]) -> Score:
    delays = []
    missed = 0
    for loss in losses:
        first = next((t for t, f in seen if loss.start_s <= t < loss.end_s and f is Flag.BAD), None)
        if first is None:
            missed += 1
        else:
            delays.append((first - loss.start_s) * 1e3)
    return Score(delays_ms=tuple(delays), missed=missed)
