"""What speaks against all flags at once: how long it is held, and which reason goes first."""

import copy

import numpy as np
import pytest

from dbc.frame import MS, SECOND
from dbc.records import INTEGRITY, TRAIN_INPUTS
from gateway.core import integrity as module
from gateway.core.codes import Flag, Reason
from gateway.core.integrity import INTRUDER_HOLD_NS
from tests.reference import integrity as reference
from tests.stations import IntegrityMonitor

TICK = 10 * MS


def told(*notes, ticks=1):
    doubt = IntegrityMonitor(TICK)
    for k in range(ticks):
        for note in notes:
            note(doubt)
        doubt.tick(k * TICK, 0)
    return doubt


def test_nothing_is_known_at_the_start():
    assert told().reason is Reason.NONE
    assert not told().overrun


def test_late_ticks_count_when_they_come_in_a_row():
    late = lambda doubt: doubt.note_overrun(2)  # noqa: E731
    assert told(late, ticks=3).reason is Reason.NONE
    assert told(late, ticks=4).reason is Reason.OVERRUN
    assert told(late, ticks=4).deadline_misses == 8
    doubt = told(late, ticks=4)
    doubt.tick(4 * TICK, 0)
    assert doubt.reason is Reason.NONE
    assert doubt.overrun
    doubt.tick(3 * TICK + SECOND, 0)
    assert doubt.overrun
    doubt.tick(4 * TICK + SECOND, 0)
    assert not doubt.overrun


def test_a_tick_in_time_ends_the_row():
    doubt = told()
    for k, wanted in enumerate([Reason.NONE] * 3 + [Reason.OVERRUN] * 2, start=1):
        doubt.note_overrun(1)
        doubt.tick(k * TICK, 0)
        assert doubt.reason is wanted


@pytest.mark.parametrize("begin", [0, 7 * TICK, 12_345_678_901])
def test_how_long_lost_frames_count_depends_on_no_clock(begin):
    doubt = IntegrityMonitor(TICK)
    doubt.note_lost(3)
    said = []
    for k in range(8):
        doubt.tick(begin + k * TICK, 0)
        said.append(doubt.reason)
    assert said == [Reason.SEQUENCE] * 5 + [Reason.NONE] * 3


def test_an_intruder_is_known_only_to_who_watches_and_is_never_forgotten():
    doubt = IntegrityMonitor(TICK)
    doubt.tick(0, 3)
    assert not doubt.intruder
    doubt.watching = True
    doubt.tick(TICK, 0)
    assert not doubt.intruder
    doubt.tick(2 * TICK, 1)
    doubt.note_lost(1)
    for k in range(3, 1000):
        doubt.note_overrun(1)
        doubt.tick(k * TICK, 0)
    assert doubt.reason is Reason.INTRUDER


def test_unknown_lasts_as_long_as_the_intruder_and_ten_seconds_more():
    doubt = IntegrityMonitor(TICK, intruder_hold_ns=INTRUDER_HOLD_NS)
    doubt.watching = True
    for k in range(300):
        doubt.tick(k * TICK, int(k % 100 == 0))
        assert doubt.reason is Reason.INTRUDER
    doubt.tick(200 * TICK + 10 * SECOND, 0)
    assert doubt.reason is Reason.INTRUDER
    doubt.tick(201 * TICK + 10 * SECOND, 0)
    assert doubt.reason is Reason.NONE
    assert doubt.intruder, "it was there, all the same"
    doubt.tick(60 * SECOND, 1)
    assert doubt.reason is Reason.INTRUDER, "it is back"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("authenticated", [False, True])
@pytest.mark.parametrize("stops", [False, True])
@pytest.mark.parametrize("hold_ns", [None, 200 * MS])
def test_it_equals_the_reference(seed, authenticated, stops, hold_ns):
    """Notes of every kind at random, ticks of any length."""
    rng, now, met = np.random.default_rng(seed), 0, set()
    words = {"authenticated": authenticated, "intruder_hold_ns": hold_ns, "stops": stops}
    ours, theirs = IntegrityMonitor(TICK, **words), reference.IntegrityMonitor(TICK, **words)
    train = np.zeros(1, TRAIN_INPUTS)
    pointer = module.ffi.from_buffer("struct train_inputs *", train)
    for _ in range(2000):
        now += int(rng.choice([TICK, TICK, TICK, 3 * TICK, SECOND]))
        watched = bool(rng.random() < 0.7)
        missed = int(rng.integers(1, 4)) * (rng.random() < (0.7 if now // SECOND % 3 else 0.1))
        lost, own = (int(rng.integers(1, 9)) * (rng.random() < 0.02) for _ in range(2))
        for one in (ours, theirs):
            one.watching = watched
            if missed:
                one.note_overrun(missed)
            if lost:
                one.note_lost(lost)
            one.tick(now, own)
        names = ("reason", "overrun", "intruder", "deadline_misses", "silent", "mute")
        found = tuple(getattr(ours, name) for name in names)
        assert found == tuple(getattr(theirs, name) for name in names)
        mode = list(Flag)[rng.integers(3)]
        module.lib.fill_train_inputs(ours.pointer, mode, pointer)
        assert train.tolist() == [(found[0], mode, found[4], found[1])]
        met.add(found[0])
    wanted = {Reason.NONE, Reason.OVERRUN, Reason.SEQUENCE, Reason.INTRUDER}
    assert met == wanted - ({Reason.INTRUDER} if authenticated else set()) or met >= {
        Reason.INTRUDER
    }


def test_damaged_records_cost_no_more_than_a_wrong_answer():
    rng = np.random.default_rng(7)
    for _ in range(2000):
        one = IntegrityMonitor(TICK)
        one.record.view(np.uint8)[:] = rng.integers(0, 256, INTEGRITY.itemsize, dtype=np.uint8)
        # A count of ticks does not come near its end.
        one.record["deadline_misses"] >>= 2
        one.record["late_in_a_row"] >>= 2
        one.record["missed_ticks"] >>= 2
        one.tick(int(rng.integers(-(1 << 63), (1 << 63) - 1)), int(rng.integers(3)))
        assert one.reason in set(Reason)
        assert one.overrun in (False, True)


def test_a_copy_has_notes_of_its_own():
    one = IntegrityMonitor(TICK)
    other = copy.deepcopy(one)
    other.note_lost(1)
    other.tick(TICK, 0)
    one.tick(TICK, 0)
    assert (one.reason, other.reason) == (Reason.NONE, Reason.SEQUENCE)
