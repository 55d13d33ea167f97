"""The flag table: debounce and latch."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.decide import TABLE, FlagState, Timing, advance, from_probability, hold
from gateway.health import PRIORITY, Flag, Reason, summary, worst

TIMING = Timing(good_ns=50, raise_ns=20, clear_ns=30)
TICK = 10


def run(evidence, timing=TIMING):
    state, now, flags = FlagState(), 0, []
    for seen in evidence:
        state = advance(state, seen, now, timing)
        flags.append(state.flag)
        now += TICK
    return flags


U, G, B = Flag.UNKNOWN, Flag.GOOD, Flag.BAD


def test_good_needs_its_time():
    assert run([G] * 7) == [U] * 5 + [G] * 2


def test_bad_needs_its_time_and_unknown_never_clears_it():
    assert run([B] * 4 + [U] * 50) == [U, U, B, B] + [B] * 50


def test_times_between_ticks_are_waited_for_and_late_ticks_are_late_enough():
    timing = Timing(good_ns=15, raise_ns=15, clear_ns=15)
    assert run([G] * 4, timing) == [U, U, G, G]
    assert run([B] * 4 + [G] * 4, timing) == [U, U, B, B, B, B, G, G]
    state = advance(FlagState(), G, 1000, timing)
    assert advance(state, G, 99_000, timing).flag is G
    # An evidence that needs no time is taken in the tick that it is there.
    at_once = Timing(0, 0, 0)
    assert [advance(FlagState(), seen, 0, at_once).flag for seen in (U, G, B)] == [U, G, B]


def test_a_flag_starts_unknown_at_its_time():
    assert FlagState() == (U, U, 0)


def test_clearing_needs_uninterrupted_good():
    flags = run([B] * 3 + [G, G, U, G, G, G, G])
    assert flags[3:] == [B, B, B, B, B, B, G]


def test_unknown_takes_good_back_at_once():
    assert run([G] * 6 + [U, G]) == [U] * 5 + [G, U, U]


@given(st.lists(st.sampled_from([U, G, B]), max_size=60))
def test_good_is_only_ever_said_on_good_or_not_yet_bad_evidence(evidence):
    for before, flag, seen in zip([U, *run(evidence)], run(evidence), evidence, strict=False):
        if flag is G:
            assert seen is not U
        if before is B and flag is not B:
            assert flag is G
            assert seen is G


def test_table_has_no_way_from_bad_to_unknown():
    for (flag, seen), (target, _) in TABLE.items():
        assert not (flag is B and target is U)
        assert not (seen is U and target is G)


@pytest.mark.parametrize(
    ("lost", "known", "flag"),
    [
        (0.0, True, G), (0.5, True, G), (0.7, True, None), (0.9, True, B), (1.0, True, B),
        (0.0, False, U), (float("nan"), True, U), (1.5, True, U), (-0.1, True, U),
    ],
)  # fmt: skip
def test_probability_to_evidence(lost, known, flag):
    assert from_probability(lost, known, 0.9, 0.5) is flag


def test_reason_priority_is_the_contracts():
    assert [int(r) for r in PRIORITY] == [11, 10, 9, 3, 4, 5, 7, 2, 6, 8, 1]
    for a, b in itertools.combinations(PRIORITY, 2):
        assert worst([b, a, Reason.NONE]) is a
    assert worst([]) is Reason.NONE


def test_summary_of_a_set():
    assert summary([G, B, U]) is B
    assert summary([G, U]) is U
    assert summary([G, G]) is G
    assert summary([]) is U


def test_ticks_between_the_thresholds_do_not_count():
    timing = Timing(good_ns=0, raise_ns=20, clear_ns=30)
    state = FlagState(Flag.GOOD, Flag.GOOD, 0)
    assert hold(state, 10) == state
    state = advance(state, Flag.BAD, 100, timing)
    for _ in range(5):
        state = hold(state, 10)
    assert state.flag is Flag.GOOD
    state = advance(state, Flag.BAD, 160, timing)
    assert state.flag is Flag.GOOD, "a single tick of evidence and five of doubt"
    assert advance(state, Flag.BAD, 170, timing).flag is Flag.BAD
