"""Flags in Python, which `gateway/core/flags.c` is compared with: debounce, reasons, summaries.

Unknown never clears bad. Good is said only after good evidence has held; any unknown
evidence takes good back at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from gateway.core.codes import Flag, Reason
from gateway.core.flags import Timing

# (flag now, evidence) -> (flag next, which hold time must have passed first).
# A pair that is not listed changes nothing.
TABLE: dict[tuple[Flag, Flag], tuple[Flag, str]] = {
    (Flag.UNKNOWN, Flag.GOOD): (Flag.GOOD, "good_ns"),
    (Flag.UNKNOWN, Flag.BAD): (Flag.BAD, "raise_ns"),
    (Flag.GOOD, Flag.UNKNOWN): (Flag.UNKNOWN, ""),
    (Flag.GOOD, Flag.BAD): (Flag.BAD, "raise_ns"),
    (Flag.BAD, Flag.GOOD): (Flag.GOOD, "clear_ns"),
}

PRIORITY = tuple(Reason(n) for n in (11, 10, 9, 3, 4, 5, 7, 2, 6, 8, 1))
"""Highest first; the frame's `Reason` is the first of these that any unknown drive has."""


class FlagState(NamedTuple):
    """One flag with the evidence it sees and since when that has been the same."""

    flag: Flag = Flag.UNKNOWN
    evidence: Flag = Flag.UNKNOWN
    since_ns: int = 0


def advance(state: FlagState, evidence: Flag, now_ns: int, timing: Timing) -> FlagState:
    """One tick of one flag."""
    since = state.since_ns if evidence == state.evidence else now_ns
    rule = TABLE.get((state.flag, evidence))
    if rule is None:
        return FlagState(state.flag, evidence, since)
    target, hold = rule
    if now_ns - since >= (getattr(timing, hold) if hold else 0):
        return FlagState(target, evidence, since)
    return FlagState(state.flag, evidence, since)


def hold(state: FlagState, tick_ns: int) -> FlagState:
    """One tick between the thresholds: it does not count towards a change of the flag."""
    if state.evidence is state.flag:
        return state
    return state._replace(since_ns=state.since_ns + tick_ns)


def from_probability(lost: float, known: bool, raise_at: float, clear_at: float) -> Flag | None:
    """Evidence of one drive's loss probability; None between the thresholds.

    There the evidence of before stands, but no flag changes by it: see `hold`. Written so that
    NaN is unknown.
    """
    if not known or not 0.0 <= lost <= 1.0:
        return Flag.UNKNOWN
    if lost >= raise_at:
        return Flag.BAD
    return Flag.GOOD if lost <= clear_at else None


def worst(reasons: Sequence[Reason]) -> Reason:
    """The reason of highest priority; NONE of none."""
    ranks = (*PRIORITY, Reason.NONE)
    return min(reasons, key=ranks.index, default=Reason.NONE)


def summary(flags: Sequence[Flag]) -> Flag:
    """One flag for a set of drives: bad if any is bad, else unknown if any is, else good."""
    if Flag.BAD in flags:
        return Flag.BAD
    return Flag.GOOD if flags and Flag.UNKNOWN not in flags else Flag.UNKNOWN
