"""The storm with wrong values and wheels that run away, and that its oracle knows both.

Seeds 2000-2999: every filter, detector, bus and train, single and several ticks in a call, in 96.
"""

from collections import Counter

import numpy as np
import pytest

from gateway.core.codes import Flag
from gateway.core.flags import FlagKind
from gateway.settings.config import parse
from tests.stepped import Stepped
from tests.storm import campaign
from tests.storm.bus_faults import BUS_KINDS, KINDS, Fault, plan
from tests.storm.campaign import FD_SEEDS, VALUE_SEEDS, config_of, faults_of, first_of, weather
from tests.storm.oracle import Oracle
from tests.storm.train import LOOP_TICKS, NODES, PHASES, train
from tests.storm.value_faults import KINDS_OF_CURRENT, VALUE_KINDS, Error
from tests.storm.values import CREEP, HELD_TICKS, REACTION_TICKS, Truth, ValueRules

TICKS = 3000
RUNAWAY_SEED = 2064
QUICK = (2016, 2023, 2033, 2045, 2058, 2066, 2073, 2080)
"""For every change: each filter and detector, single and several ticks, and all trains but wheels
that run away on CAN FD, of which no other test needs the recording."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [
    pytest.param(seed, marks=[pytest.mark.thorough] * (seed not in QUICK))
    for seed in VALUE_SEEDS[:96]
])  # fmt: skip
def test_no_seed_with_wrong_values_breaks_a_rule(seed):
    result = weather(seed, TICKS)
    assert not result.found, result.text()
    assert result.ticks == TICKS


def test_the_seeds_meet_every_filter_detector_bus_train_and_way_of_stepping():
    met = {
        (
            config.estimator.kind, config.adhesion.detector, config.dbc.file,
            campaign.creeps(seed), campaign.in_calls(seed),
        )
        for seed in VALUE_SEEDS[:96]
        for config in [config_of(seed)]
    }  # fmt: skip
    assert len(met) == 2 * 4 * 2 * 2 * 2


def test_the_seeds_bring_every_fault_to_every_phase():
    met = Counter()
    for seed in VALUE_SEEDS[:300]:
        phase = train(creeps=campaign.creeps(seed)).phase
        end = first_of(seed) + TICKS
        for fault in faults_of(seed, TICKS):
            ticks = np.arange(fault.first, min(fault.last, end))
            hit = np.bincount(phase[(ticks - 1) % LOOP_TICKS], minlength=len(PHASES))
            for name, count in zip(PHASES, hit.tolist(), strict=True):
                met[fault.kind, name] += count
    assert not campaign.uncovered(+met, KINDS)


def test_the_quick_seeds_are_of_every_kind():
    assert campaign.creeps(RUNAWAY_SEED)
    assert not campaign.in_calls(RUNAWAY_SEED)
    met = [(config_of(s), campaign.creeps(s), campaign.in_calls(s)) for s in QUICK]
    assert {config.estimator.kind for config, *_ in met} == {"ekf", "ukf"}
    assert len({config.adhesion.detector for config, *_ in met}) == 4
    trains = {(config.dbc.file, creeps) for config, creeps, _ in met}
    assert trains == {("traction.dbc", False), ("traction.dbc", True), ("traction_fd.dbc", False)}
    assert len({(creeps, in_calls) for _, creeps, in_calls in met}) == 4


@pytest.mark.parametrize("seed", [0, 5, FD_SEEDS, FD_SEEDS + 8])
def test_seeds_of_before_bring_what_they_always_did(seed):
    assert first_of(seed) == 1
    assert not campaign.creeps(seed)
    assert faults_of(seed, 100_000) == plan(seed, 100_000, len(NODES))
    assert {fault.kind for fault in faults_of(seed, 100_000)} <= set(BUS_KINDS)


def test_wrong_values_are_one_drives_and_of_every_kind():
    faults = [
        f for seed in VALUE_SEEDS[:100] for f in faults_of(seed, TICKS) if f.kind in VALUE_KINDS
    ]
    assert {(f.kind, f.drive) for f in faults} == {(k, d) for k in VALUE_KINDS for d in range(3)}


def runs(far):
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
    return (edges[1::2] - edges[::2]).tolist()


def test_wheels_run_away_where_no_drive_limits_its_slip_and_only_there():
    free, limited = train(creeps=True), train()
    for d in range(len(NODES)):
        assert sum(length > 2 * REACTION_TICKS for length in runs(free.creep[:, d] > CREEP)) >= 2
        assert max(runs(limited.creep[:, d] > CREEP), default=0) < REACTION_TICKS
    # They come back, and the round ends as it began.
    assert (free.creep[-500:] < CREEP).all()
    assert np.abs(free.speed[-1] - limited.speed[-1]).max() < 1.0


# ---- what the rules say --------------------------------------------------------------------------

CONFIG = parse({})
FIRST = 1000


def truth(speed=27.0, load=18.0, lost=False, creep=0.01, off_a=0.0, off_rpm=0.0):
    """Of three drives; what is off is the second's."""
    second = np.array([0.0, 1.0, 0.0])
    return Truth(
        np.full(3, speed), np.array([False, lost, False]), np.full(3, load),
        np.array([0.01, creep, 0.01]), Error(off_a * second, off_rpm * second),
    )  # fmt: skip


def found(story, sensor=1):
    """Violations, (tick, rule, drive). story: (ticks, flags, truth, faults) one after the other."""
    rules, out = ValueRules(CONFIG, FIRST), []
    tick = FIRST
    for ticks, flags, what, faults in story:
        for _ in range(ticks):
            rules.look(
                tick, flags, sensor, what, faults, lambda t, rule, d, _: out.append((t, rule, d))
            )
            tick += 1
    return out


def of(kind, drive=1):
    return [Fault(kind, 0, 1 << 40, drive, 1.0)]


GOOD, LOST, UNKNOWN = (1, 1, 1), (1, 2, 1), (1, 0, 1)
QUIET = (400, GOOD, truth(), [])
FAR_A = 10.0


def test_wrong_values_may_be_believed_for_200_ms_and_no_longer():
    wrong = truth(off_a=FAR_A)
    assert not found([QUIET, (REACTION_TICKS, GOOD, wrong, of("held"))])
    late = found([QUIET, (REACTION_TICKS + 1, GOOD, wrong, of("held"))])
    assert late == [(FIRST + 400 + REACTION_TICKS, "wrong_values", 2)]
    assert not found([QUIET, (20, GOOD, wrong, of("held")), (100, UNKNOWN, wrong, of("held"))])


@pytest.mark.parametrize(
    "what",
    [
        truth(off_a=1.0), truth(speed=5.0, off_a=FAR_A), truth(load=3.0, off_a=FAR_A),
        truth(off_rpm=9.0),
    ],
)  # fmt: skip
def test_what_does_not_matter_may_be_believed(what):
    assert not found([QUIET, (100, GOOD, what, of("held"))])


def test_a_sensor_fault_is_as_good_as_unknown():
    assert not found([QUIET, (100, GOOD, truth(off_a=FAR_A), of("held"))], sensor=2)


def test_a_held_speed_counts_once_it_is_off():
    story = [QUIET, (100, GOOD, truth(off_rpm=20.0), of("held_motion"))]
    assert {rule for _, rule, _ in found(story)} == {"wrong_values"}


def test_a_loss_out_of_wrong_values_is_false_at_any_time_and_for_three_seconds_after():
    wrong = truth(off_a=FAR_A)
    at_once = [QUIET, (5, GOOD, wrong, of("late")), (1, LOST, wrong, of("late"))]
    assert found(at_once) == [(FIRST + 405, "false_loss", 2)]
    after = [QUIET, (50, UNKNOWN, wrong, of("late")), (100, UNKNOWN, truth(), []),
             (1, LOST, truth(), [])]  # fmt: skip
    assert found(after) == [(FIRST + 550, "false_loss", 2)]
    assert not found([QUIET, (1, LOST, truth(), [])]), "an honest drive's is another rule's"


def test_a_loss_of_a_wheel_that_slides_or_has_just_slid_is_none():
    wrong = of("late")
    slid = [QUIET, (30, UNKNOWN, truth(lost=True), wrong), (1, LOST, truth(), wrong)]
    assert not found(slid)
    held = [QUIET, (30, UNKNOWN, truth(lost=True), wrong), (HELD_TICKS, UNKNOWN, truth(), wrong),
            (1, LOST, truth(), wrong)]  # fmt: skip
    assert [rule for _, rule, _ in found(held)] == ["false_loss"]
    standing = [QUIET, (30, LOST, truth(lost=True), []), (200, LOST, truth(), wrong)]
    assert not found(standing), "an already standing loss"


def test_other_drives_go_on_while_two_of_them_can_be_compared():
    story = [QUIET, (50, UNKNOWN, truth(off_a=FAR_A), of("held"))]
    gone = [*story, (1, (0, 0, 1), truth(off_a=FAR_A), of("held"))]
    assert found(gone) == [(FIRST + 450, "others", 1)]
    two = [*of("held"), *of("held", 2)]
    few = [QUIET, (50, UNKNOWN, truth(), two), (1, (0, 0, 0), truth(), two)]
    assert not found(few)
    disturbed = [*story, (1, (0, 0, 1), truth(), [*of("held"), Fault("drop", 0, 9999, 0, 1.0)])]
    assert not found(disturbed)


def test_a_creeping_wheel_may_be_called_good_for_200_ms_and_no_longer():
    creeping = truth(creep=0.11)
    assert not found([QUIET, (REACTION_TICKS, GOOD, creeping, [])])
    late = found([QUIET, (REACTION_TICKS + 1, GOOD, creeping, [])])
    assert late == [(FIRST + 400 + REACTION_TICKS, "creep", 2)]
    assert not found([QUIET, (100, UNKNOWN, creeping, [])])
    assert not found([QUIET, (100, GOOD, truth(creep=0.09), [])])


# ---- a broken gateway is found -------------------------------------------------------------------

WRONG = [Fault("swapped", 2050, 2200, 1, 1.0)]
"""While the train rolls at full speed and no wheel slides."""


def says(monkeypatch, flags, tick):
    """A gateway that sends these flags from a tick on; None: what it thinks."""
    known = []

    def hide(made):
        mine = made.status.drives["flag"]["state"][:, FlagKind.ADHESION]
        known[:] = [mine.copy()]
        for d, flag in enumerate(flags):
            if flag is not None and made.now >= tick * campaign.TICK:
                mine[d] = flag

    def show(made):
        made.status.drives["flag"]["state"][:, FlagKind.ADHESION] = known[0]

    def make(*given):
        made = Stepped(*given)
        made.after("published", hide)
        made.after("sent", show)
        return made

    monkeypatch.setattr(campaign, "Gateway", make)


class Found(Exception):
    """The oracle has noticed."""


@pytest.mark.parametrize(
    ("rule", "flags", "faults", "seed"),
    [
        ("wrong_values", (1, 1, 1), WRONG, 0),
        ("false_loss", (None, 2, None), WRONG, 0),
        ("others", (0, None, None), WRONG, 0),
        ("creep", (1, 1, 1), [], RUNAWAY_SEED),
    ],
)
def test_the_oracle_finds_a_gateway_that_breaks_the_rule(rule, flags, faults, seed, monkeypatch):
    def noticed(_self, _tick, by, _drive, _why):
        if by == rule:
            raise Found

    monkeypatch.setattr(campaign, "plan", lambda *_: faults)
    monkeypatch.setattr(campaign, "first_of", lambda _: 1)
    monkeypatch.setattr(Oracle, "_broken", noticed)
    says(monkeypatch, flags, 2100 if faults else 500)
    with pytest.raises(Found):
        weather(seed, 3000)


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("kind", KINDS_OF_CURRENT)
def test_a_gateway_that_is_whole_breaks_no_rule_by_one_fault(kind, seed, monkeypatch):
    """EKF and UKF."""
    faults = [Fault(kind, 2050, 2200, 1, 1.0)]
    monkeypatch.setattr(campaign, "plan", lambda *_: faults)
    result = weather(seed, 2600)
    assert not result.found, result.text()
    assert result.said["adhesion", Flag.GOOD] > 2000
