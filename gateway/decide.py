"""From evidence to flags: debounce and latch, as a table.

Unknown never clears bad. Good is said only after good evidence has held; any unknown
evidence takes good back at once. To change the timing of a flag, change `Timing` or the
table, and commit the golden difference with it. The drives' flags run through the same table as
arrays (`gateway/_said_kernels.py`).
"""

from __future__ import annotations

from typing import Final, NamedTuple

from gateway.health import Flag


class Timing(NamedTuple):
    """How long evidence must hold, ns."""

    good_ns: int
    raise_ns: int
    clear_ns: int


# (flag now, evidence) -> (flag next, which hold time must have passed first).
# A pair that is not listed changes nothing.
TABLE: dict[tuple[Flag, Flag], tuple[Flag, str]] = {
    (Flag.UNKNOWN, Flag.GOOD): (Flag.GOOD, "good_ns"),
    (Flag.UNKNOWN, Flag.BAD): (Flag.BAD, "raise_ns"),
    (Flag.GOOD, Flag.UNKNOWN): (Flag.UNKNOWN, ""),
    (Flag.GOOD, Flag.BAD): (Flag.BAD, "raise_ns"),
    (Flag.BAD, Flag.GOOD): (Flag.GOOD, "clear_ns"),
}


HOLDS: Final = ("", *Timing._fields)
"""What the table names; their places are those in `said.Rules.timing`."""


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


def hold(state: FlagState, tick_ns: int) -> FlagState:
    """One tick between the thresholds: it does not count towards a change of the flag."""
    if state.evidence is state.flag:
        return state
    return state._replace(since_ns=state.since_ns + tick_ns)
