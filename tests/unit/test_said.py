"""Which inputs of a drive are believed, against the words of the contract."""

import numpy as np
import pytest

from gateway import _inputs_kernels, inputs
from gateway.channel import ChannelState
from gateway.health import Flag, Reason
from gateway.inputs import NONE
from gateway.pairing import drive_inputs, state_of
from gateway.slow import start as slow_of
from tests.reference.flags import worst

N = 3
NUMBERS = np.array([0.0, -3.5, 0.2, 0.7, 0.69, 1.0, 1.5, np.nan, np.inf])


def uncompiled(function):
    """The same where nothing is compiled (NUMBA_DISABLE_JIT=1)."""
    return getattr(function, "py_func", function)


def test_the_numbers_are_those_of_the_words():
    for name in ("NONE", "STALE", "CORRUPTED", "SEQUENCE", "RANGE", "CONFIG"):
        assert getattr(_inputs_kernels, f"_{name}") == Reason[name]
    for flag in Flag:
        assert getattr(_inputs_kernels, f"_{flag.name}") == flag


def test_of_two_reasons_the_worse_one():
    for one in Reason:
        for other in Reason:
            assert _inputs_kernels.worse(int(one), int(other)) == worst([one, other])


def channels(rng, count):
    ints = rng.integers(-1, 30, (len(ChannelState._fields), count))
    state = ChannelState(*ints)
    reason = rng.choice([Reason.NONE, Reason.NONE, *Reason], count).astype(np.int64)
    return state._replace(
        seen_valid=rng.random(count) < 0.7, reason=reason, limit_ns=np.full(count, 20),
        heard_ns=rng.choice([-1, -1, 5, 29], count),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_what_is_believed_of_inputs(seed):
    """Against the words of the contract, drive by drive; and uncompiled."""
    rng = np.random.default_rng(seed)
    met = set()
    for _ in range(200):
        rows = [(5 * k, 5 * k + 5, [5 * k, 5 * k + 1], 5 * k + 2, 5 * k + 3) for k in range(N)]
        if rng.random() < 0.2:
            rows[1] = (5, 10, [], NONE, 8)
        if rng.random() < 0.2:
            rows[2] = (10, 15, [13], 12, NONE)
        if rng.random() < 0.2:
            rows[0] = (0, 5, [3, 4], *rng.permutation([0, 1]))
        places = inputs.places(rows, [25] * N, [1.0] * N)
        state, pairs, slow = channels(rng, 15), state_of(drive_inputs(N)), slow_of(N)
        pairs.sample_ns[:], pairs.sum_error[:] = (
            rng.integers(-1, 30, N),
            rng.choice([0.5, 1.0, 2.0], N),
        )
        slow.speed[:], slow.command[:] = rng.choice(NUMBERS, (2, N))
        lost, intruder, now = (
            rng.random(N) < 0.2,
            bool(rng.random() < 0.1),
            int(rng.choice([12, 30])),
        )
        out, again = inputs.inputs(N), inputs.inputs(N)
        _inputs_kernels.look(now, lost, intruder, places, state, pairs, slow, out)
        uncompiled(_inputs_kernels.look)(now, lost, intruder, places, state, pairs, slow, again)
        assert repr(out) == repr(again)
        for k, (first, last, electrical, motion, status) in enumerate(rows):
            suspect = pairs.sum_error[k] > 1.0
            reasons = [Reason(int(state.reason[c])) for c in electrical]
            reasons += [Reason.RANGE] * int(suspect) + [Reason.STALE] * int(lost[k])
            cause = worst(reasons) if electrical else Reason.CONFIG
            assert out.cause[k] == cause
            sampled = pairs.sample_ns[k] >= 0 and now - pairs.sample_ns[k] <= 25
            assert out.fresh[k] == (sampled and cause is not Reason.STALE)

            def fresh(c, state=state, now=now):
                return c != NONE and 0 <= state.good_ns[c] >= now - 20 and state.reason[c] == 0

            assert out.commanded[k] == (fresh(status) and not np.isnan(slow.command[k]))
            speed = slow.speed[k] if fresh(motion) else np.nan
            np.testing.assert_equal(out.speed[k], speed)
            mine = range(first, last)
            ill = {Reason.STALE, Reason.CORRUPTED, Reason.SEQUENCE}
            unheard = [c for c in mine if not state.seen_valid[c]]
            due = [c for c in unheard if state.heard_ns[c] >= 0 or c in electrical]
            comm = Flag.UNKNOWN if (due if electrical else unheard) else Flag.GOOD
            gone = [c for c in mine if c not in unheard and state.reason[c] in ill]
            if lost[k] or intruder or gone:
                comm = Flag.BAD
            assert out.comm[k] == comm
            met.add((cause, comm))
    assert len(met) > 20
