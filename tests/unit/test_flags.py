"""Debounce and latch of a flag, evidence of a probability, reasons and summaries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core import flags
from gateway.core.codes import Flag, GatewayState, Reason
from gateway.core.flags import UNCHANGED, FlagKind, Timing
from tests.stations import Flags, debounce, flag, loss_evidence

TIMING = Timing(good_ns=50, raise_ns=20, clear_ns=30)
TICK = 10


def state(one):
    return Flag(one["state"].item())


def run(evidence, timing=TIMING):
    one, out = flag(0), []
    for tick, seen in enumerate(evidence):
        before = state(one)
        assert debounce(one, seen, timing, TICK, tick * TICK) == (state(one) != before)
        out.append(state(one))
    return out


U, G, B = Flag.UNKNOWN, Flag.GOOD, Flag.BAD


def test_good_needs_its_time():
    assert run([G] * 7) == [U] * 5 + [G] * 2


def test_bad_needs_its_time_and_unknown_never_clears_it():
    assert run([B] * 4 + [U] * 50) == [U, U, B, B] + [B] * 50


def test_times_between_ticks_are_waited_for_and_late_ticks_are_late_enough():
    timing = Timing(good_ns=15, raise_ns=15, clear_ns=15)
    assert run([G] * 4, timing) == [U, U, G, G]
    assert run([B] * 4 + [G] * 4, timing) == [U, U, B, B, B, B, G, G]
    one = flag(0)
    debounce(one, G, timing, TICK, 1000)
    debounce(one, G, timing, TICK, 99_000)
    assert state(one) is G
    # An evidence that needs no time is taken in the tick that it is there.
    assert [run([seen], Timing(0, 0, 0)) for seen in (U, G, B)] == [[U], [G], [B]]


def test_a_flag_starts_unknown_at_its_time():
    assert flag(70).tolist() == [(70, U, U)]


def test_clearing_needs_uninterrupted_good():
    assert run([B] * 3 + [G, G, U, G, G, G, G])[3:] == [B, B, B, B, B, B, G]


def test_unknown_takes_good_back_at_once():
    assert run([G] * 6 + [U, G]) == [U] * 5 + [G, U, U]


@given(st.lists(st.sampled_from([U, G, B, UNCHANGED]), max_size=60))
def test_bad_is_only_ever_left_for_good_on_good_evidence(evidence):
    out = run(evidence)
    for before, now, seen in zip([U, *out], out, evidence, strict=False):
        if now is G:
            assert seen != U
        if before is B and now is not B:
            assert now is G
            assert seen == G


@pytest.mark.parametrize(
    ("probability", "evidence"),
    [
        (0.0, G), (0.5, G), (0.501, UNCHANGED), (0.7, UNCHANGED), (0.899, UNCHANGED), (0.9, B),
        (1.0, B), (float("nan"), U), (1.5, U), (-3.5, U), (-0.1, U), (-1e-9, U),
        (float("inf"), U), (-float("inf"), U), (-1e-300, U), (1.0 + 1e-15, U),
    ],
)  # fmt: skip
def test_probability_to_evidence(probability, evidence):
    rules = flags.rules([TIMING] * 5, TIMING, 0.9, 0.5, TICK)
    assert loss_evidence(rules, probability) == evidence


def test_ticks_between_the_thresholds_do_not_count():
    timing = Timing(good_ns=0, raise_ns=20, clear_ns=30)
    assert run([G, *[UNCHANGED] * 3], timing) == [G] * 4
    between = [UNCHANGED] * 5
    assert run([G, B, *between, B], timing)[-1] is G, "two ticks of evidence and five of neither"
    assert run([G, B, *between, B, B], timing)[-1] is B


def test_of_drives_of_which_nothing_is_known_nothing_is_sent_as_known():
    made = Flags(flags.rules([TIMING] * 5, TIMING, 0.9, 0.5, TICK), 3, 4, 20)
    drives, train = made.status
    assert (drives["flag"]["state"] == U).all()
    assert (drives["flag"]["since_ns"] == 20).all()
    assert drives["flag"].shape == (3, len(FlagKind))
    for name in ("adhesion_reason", "thermal_reason"):
        assert (drives[name] == Reason.STARTING).all()
    numbers = [name for name in drives.dtype.names if drives.dtype[name].kind == "f"]
    assert len(numbers) == 12
    assert np.isnan([drives[name] for name in numbers]).all()
    assert (train["detector"], train["overrun"]) == (4, G)
    assert train["state"] not in list(GatewayState)


def test_the_adhesion_flags_are_a_view_of_what_is_sent():
    made = Flags(flags.rules([TIMING] * 5, TIMING, 0.9, 0.5, TICK), 2, 0, 0)
    made.status.drives["flag"]["state"][1, FlagKind.ADHESION] = B
    assert made.adhesion["state"].tolist() == [U, B]
