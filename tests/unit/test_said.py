"""What is said of drives, as arrays: the same as the table of `decide`, the same uncompiled."""

import numpy as np
import pytest

from gateway import _inputs_kernels, _said_kernels, inputs, said, tracks
from gateway.channel import ChannelState
from gateway.decide import FlagState, Timing, advance, from_probability, hold
from gateway.health import NEVER, Flag, Health, Reason, summary, worst
from gateway.inputs import NONE
from gateway.pairing import drive_inputs, state_of
from gateway.said import SAME, Which
from gateway.slow import start as slow_of

N = 3
MS = 1_000_000
TICK = 10 * MS
TIMES = ((40, 20, 60), (0, 50, 90), (70, 0, 30), (0, 0, 20), (100, 0, 50), (40, 0, 60))
TIMING = [Timing(*(ms * MS for ms in row)) for row in TIMES]
RULES = said.rules(TIMING, 0.7, 0.2, TICK)
NUMBERS = np.array([0.0, -3.5, 0.2, 0.7, 0.69, 1.0, 1.5, np.nan, np.inf])


def uncompiled(function):
    """The same where nothing is compiled (NUMBA_DISABLE_JIT=1)."""
    return getattr(function, "py_func", function)


@pytest.mark.parametrize("seed", range(20))
def test_flags_in_arrays_go_as_single_ones(seed):
    """Evidence of all kinds, held for a while or not, in ticks of any length."""
    rng = np.random.default_rng(seed)
    flags = said.flags(N, 0)
    single = [[FlagState() for _ in range(N)] for _ in Which]
    now, met = 0, set()
    for tick in range(400):
        now += int(rng.choice([TICK, TICK, TICK, TICK // 3, 7 * TICK]))
        if tick == 0 or rng.random() < 0.4:
            seen = rng.integers(0, 3, (len(Which), N))
            seen[Which.ADHESION, rng.random(N) < 0.3] = SAME
        severe = rng.random(N) < 0.3
        before = [[state.flag for state in row] for row in single]
        changed = _said_kernels.decide(seen, severe, now, RULES, flags)
        for f, row in enumerate(single):
            for k, state in enumerate(row):
                mine = TIMING[5] if f == Which.ADHESION and severe[k] else TIMING[f]
                row[k] = (
                    hold(state, TICK)
                    if seen[f, k] == SAME
                    else advance(state, Flag(int(seen[f, k])), now, mine)
                )
                assert row[k] == tuple(column.item(f, k) for column in flags)
                met.add((state.flag, row[k].flag))
        assert changed == (before != [[state.flag for state in row] for row in single])
    assert len(met) == 8, "all but bad to unknown"


@pytest.mark.parametrize("lost", [*NUMBERS.tolist(), -1e-9])
def test_evidence_of_a_probability_is_that_of_decide(lost):
    wanted = from_probability(lost, True, RULES.raise_at, RULES.clear_at)
    assert _said_kernels.from_probability(lost, RULES) == (SAME if wanted is None else wanted)


def test_summaries_and_priorities_are_those_of_health():
    rng = np.random.default_rng(1)
    for _ in range(200):
        states = rng.integers(0, 3, rng.integers(1, 5))
        assert _said_kernels._summary(states) == summary([Flag(int(s)) for s in states])
        one, other = (Reason(int(r)) for r in rng.integers(0, len(Reason), 2))
        assert _inputs_kernels.worse(int(one), int(other)) == worst([one, other])


def drawn(rng):
    """Anything that the tables can hold, whether it can come together or not."""
    told, found, come = tracks.told(N), said.findings(N), inputs.inputs(N)
    told.health[:] = rng.integers(0, len(Health), N)
    told.reason[:] = rng.integers(0, len(Reason), N)
    for column in (told.speed, told.load, told.sigma, told.nis, found.mixed_c, found.rate_k_h):
        column[:] = rng.choice(NUMBERS, N)
    come.cause[:] = rng.integers(0, len(Reason), N) * (rng.random(N) < 0.5)
    come.suspect[:], come.comm[:] = rng.random(N) < 0.2, rng.integers(0, 3, N)
    found.thermal[:], found.sensor[:] = rng.integers(0, 3, (2, N))
    found.reason[:] = rng.integers(0, len(Reason), N)
    found.fault_class[:], found.fault_sensor[:] = rng.integers(0, 5, (2, N))
    found.heard_ns[:] = rng.choice([NEVER, 5, 77], N)
    return told, found, come


@pytest.mark.parametrize("seed", range(10))
def test_the_loops_are_the_same_functions_uncompiled(seed):
    made = []
    for kernels in (
        (_said_kernels.weigh, _said_kernels.decide, _said_kernels.tell),
        tuple(map(uncompiled, (_said_kernels.weigh, _said_kernels.decide, _said_kernels.tell))),
    ):
        weigh, decide, tell = kernels
        rng = np.random.default_rng(seed)
        flags, words = said.flags(N, 0), said.said(N, 2)
        seen, why = np.zeros((len(Which), N), dtype=np.int64), np.zeros(N, dtype=np.int64)
        out = []
        for tick in range(60):
            told, found, come = drawn(rng)
            lost, known = rng.choice(NUMBERS, N), rng.random(N) < 0.8
            wrong, uncertain, severe = rng.random((3, N)) < 0.2
            doubt = int(rng.choice([Reason.NONE, Reason.NONE, Reason.SEQUENCE, Reason.INTRUDER]))
            sample_ns = rng.choice([-1, 3, 9], N)
            silent, overrun = (bool(x) for x in rng.random(2) < 0.2)
            now = 100 + tick * TICK
            weigh(come, wrong, uncertain, told, lost, known, found, doubt, RULES, seen, why)
            changed = decide(seen, severe, now, RULES, flags)
            tell(seen, why, now, flags, come, told, lost, known, found, sample_ns, doubt,
                 np.array([[tick % 3]]),                 silent, overrun, words)  # fmt: skip
            out.append([changed, seen.tolist(), why.tolist(), *(c.tolist() for c in words)])
        made.append(repr(out))
    assert made[0] == made[1]


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
