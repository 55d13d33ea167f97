"""Evidence and what is said of it, drive by drive, against the words of the contract."""

from types import SimpleNamespace

import numpy as np
import pytest

from gateway import _inputs_kernels, _said_kernels, said
from gateway.decide import from_probability
from gateway.health import (
    NEVER,
    FaultClass,
    FaultSensor,
    Flag,
    GatewayState,
    Health,
    Reason,
    summary,
    worst,
)
from gateway.said import SAME, Which, Whole
from tests.unit.test_said import NUMBERS, RULES, N, drawn


def test_the_numbers_are_those_of_the_words():
    kernels = SimpleNamespace(**vars(_said_kernels))
    assert list(Flag) == [kernels._UNKNOWN, kernels._GOOD, kernels._BAD]
    assert (kernels._SAME, kernels._NEVER) == (SAME, NEVER)
    for which in Which:
        assert getattr(kernels, f"_{which.name}") == which
    assert len(Which) == kernels._SEVERE
    named = {"_DIVERGED_REASON": Reason.DIVERGED, "_TOO_FEW": Reason.TOO_FEW_DRIVES,
             "_SENSOR_BIAS": FaultClass.SENSOR_BIAS, "_CURRENT": FaultSensor.CURRENT,
             "_IDLE": Health.UNKNOWN, "_W_FAULTS": Whole.FAULTS_REASON,
             "_W_ADHESION": Whole.ADHESION_REASON, "_W_COMMON": Whole.COMMON_MODE,
             "_W_AGE": Whole.AGE_NS, "_W_TEMPERATURE_AGE": Whole.TEMPERATURE_AGE_NS}  # fmt: skip
    named |= {f"_{r}": Reason[r] for r in ("NONE", "STARTING", "RANGE", "INTRUDER")}
    named |= {f"_{h}": Health[h] for h in ("CONVERGING", "TRACKING", "PREDICTING", "DIVERGED")}
    named |= {f"_STATE_{state.name}": state for state in GatewayState}
    places = ("SENSOR", "COMM", "ESTIMATOR", "OVERRUN", "STATE", "DETECTOR")
    named |= {f"_W_{place}": Whole[place] for place in places}
    assert {name: getattr(kernels, name) for name in named} == named
    reasons = ("NONE", "STALE", "CORRUPTED", "SEQUENCE", "RANGE", "CONFIG")
    for name in reasons:
        assert getattr(_inputs_kernels, f"_{name}") == Reason[name]
    for flag in Flag:
        assert getattr(_inputs_kernels, f"_{flag.name}") == flag


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
        if applies:
            return Flag.UNKNOWN, why
    found = from_probability(world.lost[k], True, RULES.raise_at, RULES.clear_at)
    return SAME if found is None else found, Reason.STARTING


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


def said_of(k, told, found, come, world, before):
    """What is said of one drive."""
    adhesion, thermal = world.flags.flag[Which.ADHESION, k], world.flags.flag[Which.THERMAL, k]
    moves = told.health[k] in (Health.TRACKING, Health.PREDICTING) and not np.isnan(told.speed[k])
    current = come.suspect[k] and found.sensor[k] != Flag.BAD
    kind = FaultClass.SENSOR_BIAS if current else found.fault_class[k]
    if thermal == Flag.GOOD and world.seen[Which.THERMAL, k] != Flag.GOOD:
        kind = before.fault_class[k]  # the flag still says good: no word of a fault
    why = Reason.INTRUDER if world.doubt is Reason.INTRUDER else found.reason[k] or Reason.STARTING
    told_of = {
        name: getattr(told, name)[k] if moves else np.nan
        for name in ("speed", "load", "sigma", "nis")
    }
    heard, sampled = found.heard_ns[k], world.sample_ns[k]
    same = ("mixed_c", "maisd_k", "rate_k_h", "jumps")
    return told_of | {name: getattr(found, name)[k] for name in same} | {
        "adhesion": adhesion, "thermal": thermal,
        "adhesion_reason": world.why[k] if adhesion == Flag.UNKNOWN else Reason.NONE,
        "thermal_reason": why if thermal == Flag.UNKNOWN else Reason.NONE,
        "sensor": world.flags.flag[Which.SENSOR, k],
        "comm": world.flags.flag[Which.COMM, k],
        "estimator": world.flags.flag[Which.ESTIMATOR, k],
        "health": told.health[k], "lost": world.lost[k] if world.known[k] else np.nan,
        "fault_class": kind,
        "fault_sensor": FaultSensor.CURRENT if current else found.fault_sensor[k],
        "age_ns": NEVER if sampled < 0 else world.now - sampled,
        "temperature_age_ns": NEVER if heard == NEVER else world.now - heard,
    }  # fmt: skip


def whole_of(each, world):
    """What is said of all drives together, from what is said of each."""

    def column(name):
        return [row[name] for row in each]

    def of(name):
        return summary([Flag(int(flag)) for flag in column(name)])

    def reason(name):
        return worst([Reason(int(r)) for r in column(name)])

    def oldest(name):
        return NEVER if NEVER in column(name) else max(column(name))

    known = Flag.UNKNOWN not in column("adhesion") and not world.overrun
    idle = {Health.UNKNOWN, Health.CONVERGING}.issuperset(column("health"))
    state = GatewayState.STARTING if idle else GatewayState.DEGRADED
    if known:
        state = GatewayState.RUNNING
    common = world.mode
    if common is Flag.GOOD and world.doubt is not Reason.NONE:
        common = Flag.UNKNOWN
    return {
        Whole.ADHESION_REASON: reason("adhesion_reason"),
        Whole.FAULTS_REASON: reason("thermal_reason"),
        Whole.SENSOR: of("sensor"), Whole.COMM: of("comm"), Whole.ESTIMATOR: of("estimator"),
        Whole.OVERRUN: Flag.BAD if world.overrun else Flag.GOOD,
        Whole.STATE: GatewayState.SILENT if world.silent else state,
        Whole.DETECTOR: 2, Whole.COMMON_MODE: common,
        Whole.AGE_NS: oldest("age_ns"), Whole.TEMPERATURE_AGE_NS: oldest("temperature_age_ns"),
    }  # fmt: skip


def weather(rng):
    """Anything around the drives; flags as often all alike as not."""
    flags = said.flags(N, 0)
    flags.flag[:] = rng.integers(0, 3, flags.flag.shape)
    flags.flag[rng.random(len(Which)) < 0.4] = rng.integers(0, 3)
    doubts = [Reason.NONE] * 4 + [Reason.SEQUENCE, Reason.OVERRUN, Reason.INTRUDER, Reason.CONFIG]
    return SimpleNamespace(
        flags=flags, lost=rng.choice(NUMBERS, N), known=rng.random(N) < 0.8,
        wrong=rng.random(N) < 0.2, doubt=doubts[rng.integers(len(doubts))],
        sample_ns=rng.choice([-1, 0, 3, 9], N, p=[0.1, 0.3, 0.3, 0.3]),
        mode=list(Flag)[rng.integers(3)], silent=bool(rng.random() < 0.1),
        overrun=bool(rng.random() < 0.2), now=int(rng.integers(100, 10**12)),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_evidence_and_words_are_the_contracts(seed):
    rng = np.random.default_rng(seed)
    words = said.said(N, 2)
    met = set()
    for _ in range(250):
        told, found, come = drawn(rng)
        found.maisd_k[:], found.jumps[:] = rng.choice(NUMBERS, N), rng.integers(0, 9, N)
        found.reason[rng.random(N) < 0.3] = Reason.NONE
        found.heard_ns[:] = rng.choice([NEVER, 0, 5, 77], N, p=[0.1, 0.3, 0.3, 0.3])
        if rng.random() < 0.3:
            told.health[:] = rng.integers(0, 3)
        world = weather(rng)
        # What stood there before must not matter, but for the last class of a fault.
        world.seen = rng.integers(-1, 3, (len(Which), N))
        world.why = rng.integers(0, len(Reason), N)
        before = said.Said(*(column.copy() for column in words))
        _said_kernels.weigh(
            come, world.wrong, np.zeros(N, dtype=np.bool_), told, world.lost, world.known, found,
            int(world.doubt), RULES, world.seen, world.why,
        )  # fmt: skip
        for k in range(N):
            adhesion, why = adhesion_of(k, told, come, world)
            assert world.seen[:, k].tolist() == [
                adhesion,
                *evidence_of(k, told, found, come, world),
            ]
            assert world.why[k] == why
        _said_kernels.tell(
            world.seen, world.why, world.now, world.flags, come, told, world.lost, world.known,
            found, world.sample_ns, int(world.doubt), np.array([[world.mode, 9], [9, 9]]),
            world.silent, world.overrun, words,
        )  # fmt: skip
        each = [said_of(k, told, found, come, world, before) for k in range(N)]
        for k, row in enumerate(each):
            assert set(row) == {*said.Said._fields} - {"whole"}
            for name, wanted in row.items():
                np.testing.assert_equal(getattr(words, name)[k], wanted, name)
        assert dict(zip(Whole, words.whole.tolist(), strict=True)) == whole_of(each, world)
        met.add((words.whole[Whole.STATE], words.whole[Whole.COMMON_MODE]))
    assert len(met) == 12


@pytest.mark.parametrize("age", [0, 7, NEVER])
def test_a_single_drive_is_the_oldest(age):
    assert _said_kernels._oldest(np.array([age])) == age
