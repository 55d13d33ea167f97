"""Which inputs of a drive are valid, against the words of the contract."""

import copy

import numpy as np
import pytest
from _traction_core import lib

from gateway.core import inputs
from gateway.core.codes import Flag, Reason
from gateway.core.inputs import NONE
from tests import columns
from tests.receivers import Received
from tests.reference.flags import worst
from tests.stations import InputMonitor

N = 3
NUMBERS = np.array([0.0, -3.5, 0.2, 0.7, 0.69, 1.0, 1.5, np.nan, np.inf])


def test_of_two_reasons_the_worse_one():
    for one in Reason:
        for other in Reason:
            assert lib.worse_reason(one, other) == worst([one, other])


def drawn(rng):
    """Anything that frames can have left behind."""
    came = Received(N, 5 * N)
    state, drives = came.channels, came.drives
    count = len(state)
    state["reason"] = rng.choice([Reason.NONE, Reason.NONE, *Reason], count)
    state["good_ns"], state["accepted_ns"] = rng.integers(-1, 30, (2, count))
    state["received_ns"] = rng.choice([-1, -1, 5, 29], count)
    state["was_valid"], state["limit_ns"] = rng.random(count) < 0.7, 20
    drives["sample_ns"], drives["current_sum"] = (
        rng.integers(-1, 30, N),
        rng.choice([0.5, 1.0, 2.0], N),
    )
    drives["speed"], drives["command"] = rng.choice(NUMBERS, (2, N))
    return came


def layout(rng):
    """Which channels are whose: mostly all of them; mapped drives lack some."""
    rows = [(5 * k, 5 * k + 5, [5 * k, 5 * k + 1], 5 * k + 2, 5 * k + 3) for k in range(N)]
    if rng.random() < 0.2:
        rows[1] = (5, 10, [], NONE, 8)
    if rng.random() < 0.2:
        rows[2] = (10, 15, [13], 12, NONE)
    if rng.random() < 0.2:
        rows[0] = (0, 5, [3, 4], *rng.permutation([0, 1]))
    return rows


def comm_of(state, row, failed):
    """Evidence of one drive's messages."""
    first, end, electrical, *_ = row
    mine = range(first, end)
    unheard = [c for c in mine if not state["was_valid"][c]]
    due = [c for c in unheard if state["received_ns"][c] >= 0 or c in electrical]
    ill = {Reason.STALE, Reason.CORRUPTED, Reason.SEQUENCE}
    gone = [c for c in mine if c not in unheard and state["reason"][c] in ill]
    if failed or gone:
        return Flag.BAD
    return Flag.UNKNOWN if (due if electrical else unheard) else Flag.GOOD


@pytest.mark.parametrize("seed", range(10))
def test_which_inputs_are_valid(seed):
    """Against the words of the contract, drive by drive."""
    rng = np.random.default_rng(seed)
    met = set()
    for _ in range(200):
        came, rows = drawn(rng), layout(rng)
        state, drives = came.channels, came.drives
        lost, intruder = rng.random(N) < 0.2, bool(rng.random() < 0.1)
        now = int(rng.choice([12, 30]))
        monitor = InputMonitor(came, inputs.places(rows, [25] * N, [1.0] * N).channels)
        monitor.status["heartbeat_lost"] = lost
        monitor.assess(intruder, now)
        out = columns.inputs_of(monitor.status)
        for k, (_, _, electrical, motion, status) in enumerate(rows):
            suspect = drives["current_sum"][k] > 1.0
            reasons = [Reason(int(state["reason"][c])) for c in electrical]
            reasons += [Reason.RANGE] * int(suspect) + [Reason.STALE] * int(lost[k])
            cause = worst(reasons) if electrical else Reason.CONFIG
            assert out.cause[k] == cause
            assert out.suspect[k] == suspect
            sample_ns = drives["sample_ns"][k]
            sampled = sample_ns >= 0 and now - sample_ns <= 25
            assert out.fresh[k] == (sampled and cause is not Reason.STALE)

            def fresh(c, state=state, now=now):
                return c != NONE and 0 <= state["good_ns"][c] >= now - 20 and not state["reason"][c]

            assert out.commanded[k] == (fresh(status) and not np.isnan(drives["command"][k]))
            speed = drives["speed"][k] if fresh(motion) else np.nan
            np.testing.assert_equal(out.speed[k], speed)
            comm = comm_of(state, rows[k], lost[k] or intruder)
            assert out.comm[k] == comm
            assert monitor.status["heartbeat_lost"][k] == lost[k]
            met.add((cause, comm))
    assert len(met) > 20


def test_before_anything_nothing_is_known():
    none = columns.inputs(2)
    assert none.cause.tolist() == [Reason.STARTING] * 2
    assert none.comm.tolist() == [Flag.UNKNOWN] * 2
    assert np.isnan(none.speed).all()
    assert not (none.fresh | none.commanded | none.suspect).any()


def test_a_copy_has_records_of_its_own():
    rng = np.random.default_rng(1)
    monitor = InputMonitor(Received(N, 5 * N), inputs.places(layout(rng), [25] * N, [1.0] * N)[0])
    twin = copy.deepcopy(monitor, {id(monitor.receiver): monitor.receiver})
    twin.assess(intruder=True, now=7)
    assert twin.status["comm"].tolist() == [Flag.BAD] * N
    assert monitor.status["comm"].tolist() == [Flag.UNKNOWN] * N
