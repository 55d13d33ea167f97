"""The flag table under any sequence of evidence, against what was seen, kept whole."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gateway.core.codes import Flag
from gateway.core.flags import UNCHANGED, Timing
from tests.fuzz import examples
from tests.stations import debounce, flag

TICK = 10
GOOD, BAD, UNKNOWN = Flag.GOOD, Flag.BAD, Flag.UNKNOWN


class FlagTable(RuleBasedStateMachine):
    """Evidence of a flag, tick by tick; None is a probability between the thresholds."""

    @initialize(times=st.tuples(*[st.integers(0, 6).map(lambda k: k * TICK)] * 3))
    def start(self, times: tuple[int, int, int]) -> None:
        self.timing = Timing(*times)
        self.now = 0
        self.flag = flag(0)
        self.before = self.state = UNKNOWN
        self.seen: list[Flag | None] = []

    @rule(evidence=st.sampled_from([GOOD, BAD, UNKNOWN, None]), ticks=st.integers(1, 8))
    def look(self, evidence: Flag | None, ticks: int) -> None:
        for _ in range(ticks):
            self.now += TICK
            self.seen.append(evidence)
            self.before = self.state
            seen = UNCHANGED if evidence is None else evidence
            debounce(self.flag, seen, self.timing, TICK, self.now)
            self.state = Flag(self.flag["state"].item())
            self.judge()

    def lasted(self, evidence: Flag) -> int:
        """ns that this evidence has held up to now; ticks between the thresholds do not count."""
        ticks = 0
        for one in reversed(self.seen):
            if one is not None and one is not evidence:
                break
            ticks += one is evidence
        return (ticks - 1) * TICK

    def judge(self) -> None:
        was, flag, evidence = self.before, self.state, self.seen[-1]
        if evidence is None:
            assert flag is was
        if was is BAD:
            assert flag is not UNKNOWN
        if flag is GOOD:
            assert evidence in (GOOD, BAD, None)
        if was is not GOOD and flag is GOOD:
            held = self.timing.clear_ns if was is BAD else self.timing.good_ns
            assert self.lasted(GOOD) >= held
        if was is not BAD and flag is BAD:
            assert self.lasted(BAD) >= self.timing.raise_ns
        if was is GOOD and flag is UNKNOWN:
            assert evidence is UNKNOWN
        # And it does come: evidence that has held long enough is said.
        if evidence is BAD and self.lasted(BAD) >= self.timing.raise_ns:
            assert flag is BAD
        if evidence is GOOD and self.lasted(GOOD) >= max(self.timing.good_ns, self.timing.clear_ns):
            assert flag is GOOD
        if evidence is UNKNOWN:
            assert flag is (BAD if was is BAD else UNKNOWN)

    @invariant()
    def only_three_states(self) -> None:
        if hasattr(self, "state"):
            assert self.state in (UNKNOWN, GOOD, BAD)


TestFlagTable = FlagTable.TestCase
TestFlagTable.settings = settings(max_examples=examples(200), stateful_step_count=40, deadline=None)
