"""`gateway/core/flags.c` against Python: all evidence, any records, damaged ones too."""

import itertools
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.records import (
    DRIVE_EVIDENCE,
    DRIVE_STATUS,
    FLAG_INPUTS,
    TRAIN_INPUTS,
    TRAIN_STATUS,
    pointer,
)
from gateway.core import flags
from gateway.core.codes import (
    NEVER,
    RANKS,
    FaultClass,
    FaultSensor,
    Flag,
    GatewayState,
    Health,
    Reason,
)
from gateway.core.flags import UNCHANGED, FlagKind, Timing
from tests import columns
from tests.reference.flags import (
    PRIORITY,
    FlagState,
    advance,
    from_probability,
    hold,
    summary,
    worst,
)
from tests.stations import Flags, debounce, flag

N = 3
MS = 1_000_000
TICK = 10 * MS
TIMES = ((40, 20, 60), (0, 50, 90), (70, 0, 30), (0, 0, 20), (100, 0, 50), (40, 0, 60))
TIMING = [Timing(*(ms * MS for ms in row)) for row in TIMES]
SEVERE = TIMING[5]
RAISE, CLEAR = 0.7, 0.2
RULES = flags.rules(TIMING[:5], SEVERE, RAISE, CLEAR, TICK)
NUMBERS = np.array([0.0, -3.5, 0.2, 0.7, 0.69, 1.0, 1.5, np.nan, np.inf])
EVIDENCE = (*Flag, UNCHANGED)


def fed(state, evidence, now, timing):
    """The reference: one tick."""
    if evidence == UNCHANGED:
        return hold(state, TICK)
    return advance(state, Flag(evidence), now, timing)


# ---- debounce ------------------------------------------------------------------------------------


@pytest.mark.parametrize("timing", [*TIMING, Timing(25 * MS, 15 * MS, 35 * MS), Timing(0, 0, 0)])
@pytest.mark.parametrize("period", [TICK, 3 * MS])
def test_every_sequence_of_evidence_of_eight_ticks(timing, period):
    """4^8 sequences, each state of a tick once; a `period` need not be that of the rules."""
    one = ffi.new("struct flag *")
    by = ffi.new("struct flag_timing *", timing)
    level = Counter({FlagState(): 1})
    for depth in range(8):
        now, reached = (depth + 1) * period, Counter()
        for (state, ways), evidence in itertools.product(level.items(), EVIDENCE):
            one.state, one.evidence, one.since_ns = state.flag, state.evidence, state.since_ns
            changed = lib.debounce(one, evidence, by, TICK, now)
            wanted = fed(state, evidence, now, timing)
            assert (one.state, one.evidence, one.since_ns) == wanted
            assert changed == (wanted.flag is not state.flag)
            reached[wanted] += ways
        level = reached
    assert level.total() == 4**8


@pytest.mark.parametrize("seed", range(20))
def test_flags_of_drives_go_as_single_ones(seed):
    """Evidence of all kinds, held for a while or not, in ticks of any length."""
    rng = np.random.default_rng(seed)
    made = Flags(RULES, N, 0, 0)
    single = [[FlagState() for _ in FlagKind] for _ in range(N)]
    now, met = 0, set()
    for tick in range(400):
        now += int(rng.choice([TICK, TICK, TICK, TICK // 3, 7 * TICK]))
        if tick == 0 or rng.random() < 0.4:
            seen = rng.integers(0, 3, (N, len(FlagKind)))
            seen[rng.random(N) < 0.3, FlagKind.ADHESION] = UNCHANGED
        severe = rng.random(N) < 0.3
        made.evidence["of"], made.evidence["severe_loss"] = seen, severe
        before = [[state.flag for state in row] for row in single]
        changed = made.debounce(now)
        for k, row in enumerate(single):
            for f, state in enumerate(row):
                mine = SEVERE if f == FlagKind.ADHESION and severe[k] else TIMING[f]
                row[f] = fed(state, int(seen[k, f]), now, mine)
                kept = made.status.drives["flag"][k, f]
                assert row[f] == (kept["state"], kept["evidence"], kept["since_ns"])
                met.add((state.flag, row[f].flag))
        assert changed == (before != [[state.flag for state in row] for row in single])
    assert len(met) == 8, "all but bad to unknown"


def test_a_damaged_flag_is_unknown_and_other_evidence_is_none():
    for state, evidence in itertools.product(range(256), (-1, 0, 1, 2, 4, 77, 1 << 30)):
        one = flag(5)
        one["state"], one["evidence"] = state, state
        changed = debounce(one, evidence, Timing(0, 0, 0), TICK, 5)
        start = state if state <= Flag.BAD else Flag.UNKNOWN
        seen = evidence if evidence in (Flag.GOOD, Flag.BAD) else Flag.UNKNOWN
        kept = FlagState(Flag(start), Flag(state) if state <= Flag.BAD else Flag.BAD, 5)
        wanted = advance(kept, Flag(seen), 5, Timing(0, 0, 0))
        assert one["state"] == wanted.flag
        assert one["evidence"] == seen
        assert changed == (wanted.flag != start)


def test_stamps_far_apart_do_not_overflow():
    one = flag(NEVER)
    one["evidence"] = Flag.GOOD
    debounce(one, Flag.GOOD, Timing(0, 0, 0), TICK, 2**63 - 1)
    one["since_ns"], one["evidence"] = 2**63 - 1, Flag.BAD
    debounce(one, UNCHANGED, Timing(0, 0, 0), TICK, 0)
    assert one["since_ns"] < 0


# ---- evidence and reasons ------------------------------------------------------------------------


def test_ranks_are_the_priorities_and_what_is_no_reason_ranks_as_none():
    ranks = [lib.reason_rank(reason) for reason in (*PRIORITY, Reason.NONE)]
    assert ranks == list(range(len(Reason)))
    assert ranks == [RANKS[reason] for reason in (*PRIORITY, Reason.NONE)]
    for number in (-1, len(Reason), 255, -(1 << 31), (1 << 31) - 1):
        assert lib.reason_rank(number) == lib.reason_rank(Reason.NONE)


def test_nothing_is_written_behind_the_drives_nor_beside_their_flags():
    def rows(dtype, count=N + 1):
        out = np.zeros(count, dtype)
        out[N:].view(np.uint8)[:] = 0xA5
        return out

    found, evidence, status = rows(FLAG_INPUTS), rows(DRIVE_EVIDENCE), rows(DRIVE_STATUS)
    train, whole = np.zeros(1, TRAIN_INPUTS), np.zeros(1, TRAIN_STATUS)
    evidence[:N]["of"] = evidence[:N]["adhesion_reason"] = Flag.BAD
    kept, before = status.copy(), [array[N:].view(np.uint8).copy() for array in (evidence, status)]
    rules = pointer("struct flag_rules", RULES)
    each, sent = pointer("struct drive_evidence", evidence), pointer("struct drive_status", status)
    assert lib.debounce_flags(rules, each, N, TICK, sent)
    for name in DRIVE_STATUS.names:
        if name != "flag":
            assert status[name].tobytes() == kept[name].tobytes(), name
    of_drives, of_train = (
        pointer("struct flag_inputs", found),
        pointer("struct train_inputs", train),
    )
    lib.collect_evidence(rules, of_train, of_drives, N, each)
    lib.publish(of_train, of_drives, each, N, TICK, sent, pointer("struct train_status", whole))
    for array, last in zip((evidence, status), before, strict=True):
        assert (array[N:].view(np.uint8) == last).all()


TEMPERATURES = (
    "thermal", "sensor", "thermal_reason", "fault_class", "fault_sensor", "mixed_c", "maisd_k",
    "rate_k_h", "jumps", "temperature_ns",
)  # fmt: skip


def drawn(rng):
    """Anything that the stations before can have found, whether it can come together or not."""
    told, found, come = (
        columns.told(N),
        np.zeros(N, FLAG_INPUTS).view(np.recarray),
        columns.inputs(N),
    )
    told.health[:] = rng.integers(0, len(Health), N)
    if rng.random() < 0.3:
        told.health[:] = rng.integers(0, 3)
    told.reason[:] = rng.integers(0, len(Reason), N)
    for column in (told.speed, told.load, told.sigma, told.nis, found.mixed_c, found.maisd_k,
                   found.rate_k_h):  # fmt: skip
        column[:] = rng.choice(NUMBERS, N)
    come.cause[:] = rng.integers(0, len(Reason), N) * (rng.random(N) < 0.5)
    come.suspect[:], come.comm[:] = rng.random(N) < 0.2, rng.integers(0, 3, N)
    found.thermal[:], found.sensor[:] = rng.integers(0, 3, (2, N))
    found.thermal_reason[:] = rng.integers(0, len(Reason), N) * (rng.random(N) < 0.7)
    found.fault_class[:], found.fault_sensor[:] = rng.integers(0, 5, (2, N))
    found.jumps[:] = rng.integers(0, 9, N)
    found.temperature_ns[:] = rng.choice([NEVER, 0, 5, 77], N, p=[0.1, 0.3, 0.3, 0.3])
    return told, found, come


def weather(rng):
    """Anything around the drives."""
    doubts = [Reason.NONE] * 4 + [Reason.SEQUENCE, Reason.OVERRUN, Reason.INTRUDER, Reason.CONFIG]
    return SimpleNamespace(
        lost=rng.choice(NUMBERS, N), known=rng.random(N) < 0.8, wrong=rng.random(N) < 0.2,
        uncertain=rng.random(N) < 0.2, severe=rng.random(N) < 0.2, off=rng.random(N) < 0.1,
        doubt=doubts[rng.integers(len(doubts))],
        sample_ns=rng.choice([-1, 0, 3, 9], N, p=[0.1, 0.3, 0.3, 0.3]),
        mode=list(Flag)[rng.integers(3)], silent=bool(rng.random() < 0.1),
        overrun=bool(rng.random() < 0.2), now=int(rng.integers(100, 10**12)),
    )  # fmt: skip


def adhesion_of(k, told, come, world):
    """Evidence of one drive's adhesion, and why it is unknown: the first that applies."""
    cause = worst([Reason(int(come.cause[k]))] + [Reason.RANGE] * int(world.wrong[k]))
    moving = Reason.STARTING if not np.isnan(told.speed[k]) else Reason(int(told.reason[k]))
    for applies, why in (
        (world.doubt is not Reason.NONE, world.doubt),
        (cause is not Reason.NONE, cause),
        (told.health[k] == Health.DIVERGED, Reason.DIVERGED),
        (told.health[k] != Health.TRACKING, moving),
        (not world.known[k], Reason.TOO_FEW_DRIVES),
    ):
        if world.off[k] and world.doubt is Reason.NONE:
            return Flag.GOOD, Reason.NOT_AVAILABLE
        if applies:
            return Flag.UNKNOWN, why
    found = from_probability(world.lost[k], True, RAISE, CLEAR)
    if world.uncertain[k] and found is not Flag.BAD:
        return Flag.UNKNOWN, Reason.RANGE
    return UNCHANGED if found is None else found, Reason.STARTING


def evidence_of(k, told, found, come, world):
    """Of the other flags, in their order."""
    intruder = world.doubt is Reason.INTRUDER
    estimator = {Health.TRACKING: Flag.GOOD, Health.DIVERGED: Flag.BAD}
    return [
        Flag.UNKNOWN if intruder else found.thermal[k],
        come.comm[k],
        estimator.get(Health(int(told.health[k])), Flag.UNKNOWN),
        Flag.BAD if come.suspect[k] else found.sensor[k],
    ]


def filled(made, told, found, come, world):
    """Every input that a tick gives."""
    for name in TEMPERATURES:
        made.inputs[name] = found[name]
    of_stations = {
        "input_reason": come.cause, "comm": come.comm, "current_sum_fault": come.suspect,
        "input_implausible": world.wrong, "sample_ns": world.sample_ns, "health": told.health,
        "health_reason": told.reason, "speed_rad_s": told.speed, "nis": told.nis,
        "load_nm": told.load, "load_sigma_nm": told.sigma, "loss_probability": world.lost,
        "loss_known": world.known, "may_spin_up": world.uncertain, "severe_loss": world.severe,
        "withdrawn": world.off,
    }  # fmt: skip
    for name, column in of_stations.items():
        made.inputs[name] = column
    train = made.train_inputs
    train["integrity_reason"], train["common_mode"] = world.doubt, world.mode
    train["silent"], train["overrun"] = world.silent, world.overrun


@pytest.mark.parametrize("seed", range(4))
def test_evidence_is_the_contracts(seed):
    rng, made, met = np.random.default_rng(seed), Flags(RULES, N, 2, 0), set()
    for _ in range(250):
        told, found, come = drawn(rng)
        world = weather(rng)
        # What stood there before must not matter.
        made.evidence["of"] = rng.integers(0, 4, (N, len(FlagKind)))
        made.evidence["adhesion_reason"] = rng.integers(0, len(Reason), N)
        filled(made, told, found, come, world)
        made.collect_evidence()
        for k in range(N):
            adhesion, why = adhesion_of(k, told, come, world)
            wanted = [adhesion, *evidence_of(k, told, found, come, world)]
            kept = made.evidence[k]
            assert kept["of"].tolist() == wanted
            assert kept["adhesion_reason"] == why
            assert kept["severe_loss"] == world.severe[k]
            met.add((adhesion, why))
    assert len(met) >= 14


# ---- what is published ---------------------------------------------------------------------------


def sent_of(k, told, found, come, world, before):
    """What is sent of one drive."""
    state, evidence = world.states[k], world.evidence[k]
    adhesion, thermal = state[FlagKind.ADHESION], state[FlagKind.THERMAL]
    moves = told.health[k] in (Health.TRACKING, Health.PREDICTING) and not np.isnan(told.speed[k])
    current = come.suspect[k] and found.sensor[k] != Flag.BAD
    kind = FaultClass.SENSOR_BIAS if current else found.fault_class[k]
    if thermal == Flag.GOOD and evidence["of"][FlagKind.THERMAL] != Flag.GOOD:
        kind = before["fault_class"][k]  # the flag still says good: no word of a fault
    why = found.thermal_reason[k] or Reason.STARTING
    if world.doubt is Reason.INTRUDER:
        why = Reason.INTRUDER
    heard, sampled = found.temperature_ns[k], world.sample_ns[k]
    moving = {"speed_rad_s": told.speed, "load_nm": told.load, "load_sigma_nm": told.sigma,
              "nis": told.nis}  # fmt: skip
    same = ("mixed_c", "maisd_k", "rate_k_h", "jumps")
    return {name: column[k] if moves else np.nan for name, column in moving.items()} | {
        name: getattr(found, name)[k] for name in same
    } | {
        "adhesion_reason": evidence["adhesion_reason"] if adhesion == Flag.UNKNOWN else Reason.NONE,
        "thermal_reason": why if thermal == Flag.UNKNOWN else Reason.NONE,
        "health": told.health[k],
        "loss_probability": world.lost[k] if world.known[k] else np.nan,
        "fault_class": kind,
        "fault_sensor": FaultSensor.CURRENT if current else found.fault_sensor[k],
        "age_ns": NEVER if sampled < 0 else world.now - sampled,
        "temperature_age_ns": NEVER if heard == NEVER else world.now - heard,
    }  # fmt: skip


def whole_of(each, world):
    """What is sent of all drives together, from what is sent of each."""

    def of(kind):
        return summary([Flag(int(state)) for state in world.states[:, kind]])

    def reason(name):
        return worst([Reason(int(row[name])) for row in each])

    def oldest(name):
        ages = [row[name] for row in each]
        return NEVER if NEVER in ages else max(ages)

    known = Flag.UNKNOWN not in world.states[:, FlagKind.ADHESION] and not world.overrun
    idle = {Health.UNKNOWN, Health.CONVERGING}.issuperset(row["health"] for row in each)
    state = GatewayState.STARTING if idle else GatewayState.DEGRADED
    if known:
        state = GatewayState.RUNNING
    common = world.mode
    if common is Flag.GOOD and world.doubt is not Reason.NONE:
        common = Flag.UNKNOWN
    return {
        "adhesion_reason": reason("adhesion_reason"), "faults_reason": reason("thermal_reason"),
        "sensor": of(FlagKind.SENSOR), "comm": of(FlagKind.COMM),
        "estimator": of(FlagKind.ESTIMATOR),
        "overrun": Flag.BAD if world.overrun else Flag.GOOD,
        "state": GatewayState.SILENT if world.silent else state,
        "detector": 2, "common_mode": common,
        "age_ns": oldest("age_ns"), "temperature_age_ns": oldest("temperature_age_ns"),
    }  # fmt: skip


CREEP = ("creep", "creep_sigma", "utilisation", "utilisation_sigma")
"""Not of `publish`: of `estimate_creep`, behind it."""


@pytest.mark.parametrize("seed", range(4))
def test_what_is_published_is_the_contracts(seed):
    rng, made = np.random.default_rng(seed), Flags(RULES, N, 2, 0)
    drives, train = made.status
    met = set()
    for _ in range(250):
        told, found, come = drawn(rng)
        world = weather(rng)
        filled(made, told, found, come, world)
        made.collect_evidence()
        # Flags as often all alike as not.
        world.states = rng.integers(0, 3, (N, len(FlagKind)))
        world.states[:, rng.random(len(FlagKind)) < 0.4] = rng.integers(0, 3)
        drives["flag"]["state"] = world.states
        world.evidence, before = made.evidence.copy(), drives.copy()
        made.publish(world.now)
        each = [sent_of(k, told, found, come, world, before) for k in range(N)]
        for k, row in enumerate(each):
            assert set(row) == {*DRIVE_STATUS.names} - {"flag", *CREEP}
            for name, wanted in row.items():
                np.testing.assert_equal(drives[k][name], wanted, name)
        np.testing.assert_array_equal(drives["flag"], before["flag"])
        wanted = whole_of(each, world)
        assert dict(zip(train.dtype.names, train[0].item(), strict=True)) == wanted
        met.add((int(train["state"][0]), int(train["common_mode"][0])))
    assert len(met) == 12


@pytest.mark.parametrize("age", [0, 7, NEVER])
def test_a_single_drive_is_the_oldest(age):
    made = Flags(RULES, 1, 2, 0)
    none = age == NEVER
    made.inputs["sample_ns"], made.inputs["temperature_ns"] = (-1, NEVER) if none else (3, 3)
    made.publish(3 + max(age, 0))
    assert made.status.train["age_ns"] == made.status.train["temperature_age_ns"] == age


def test_any_bytes_in_the_records_end_in_known_states():
    rng = np.random.default_rng(7)
    made = Flags(RULES.copy(), N, 2, 0)
    for _ in range(2000):
        for table in (made.rules, made.inputs, made.train_inputs, made.evidence, *made.status):
            raw = table.view(np.uint8)
            raw[:] = rng.choice([0, 1, 2, 3, 255, 128, rng.integers(256)], raw.shape)
        made.collect_evidence()
        made.debounce(int(rng.integers(-(2**63), 2**63 - 1)))
        made.publish(int(rng.integers(-(2**63), 2**63 - 1)))
        assert (made.status.drives["flag"]["state"] <= Flag.BAD).all()
        train = made.status.train[0]
        assert {int(train[name]) for name in ("sensor", "comm", "estimator")} <= set(Flag)
        assert train["state"] in list(GatewayState)
