"""What is learnt of the drives, and a drive's response to its own command."""

import numpy as np
import pytest

from estimators.detect import Opinion
from tests.learnt import Loads, Responses
from tests.reference import command_response as response
from tests.reference import load_reference as reference

SPREAD = 0.7 / 30.0


def learnt(ratios, seconds, noise=SPREAD, common=0.6, seed=1, memory=None):
    rng = np.random.default_rng(seed)
    n = len(ratios)
    memory = memory or Loads(n, SPREAD)
    for _ in range(round(seconds / reference.EVERY_S)):
        load = np.array(ratios) * common + rng.normal(0.0, noise, n)
        shared = float(np.mean(memory.normalised(load)[0]))
        everyone = np.ones(n, dtype=bool)
        memory.observe(load, shared, everyone, everyone)
    return memory


def test_lasting_differences_are_learnt():
    ratios = np.array([0.93, 1.0, 1.07])
    memory = learnt(ratios, 2.5)
    assert memory.ratio == pytest.approx(ratios, abs=0.02)
    assert np.all(memory.variance < 0.012**2)
    assert memory.spread == pytest.approx(SPREAD, rel=0.5)


def test_the_spread_is_that_of_the_loads():
    assert learnt((1.0, 1.0, 1.0), 20.0, noise=2.0 * SPREAD).spread == pytest.approx(
        2.0 * SPREAD, rel=0.5
    )
    assert learnt((1.0, 1.0, 1.0), 20.0, noise=0.0).spread == reference.SPREAD_FLOOR * SPREAD


def test_learning_slows_down_and_is_bounded():
    memory = learnt((1.0, 1.0, 1.0), 60.0)
    later = learnt((0.8, 1.0, 1.0), 1.0, memory=memory)
    assert later.ratio[0] > 0.98, "a loss of a second is not learnt"
    for_good = learnt((0.7, 1.0, 1.0), 600.0)
    assert for_good.ratio[0] == pytest.approx(1.0 - reference.RATIO_LIMIT, abs=1e-3)


@pytest.mark.parametrize("relative", [True, False])
def test_what_does_not_belong_to_the_model_is_not_learnt(relative):
    """A load of 75 % beside a command of 24 %: the next command had not been heard yet."""
    memory = Loads(3, SPREAD)
    load, command, before = np.array([0.75, 0.25, 0.23]), np.full(3, 0.24), memory.variance.copy()
    memory.learn(load, command, np.ones(3, dtype=bool), relative=relative)
    assert memory.ratio[0] == 1.0
    assert memory.variance[0] == before[0]
    assert memory.variance[1] < before[1]


def test_nothing_is_learnt_from_too_little():
    memory = Loads(3, SPREAD)
    start = memory.ratios.copy()
    load = np.array([0.5, 0.6, 0.6])
    memory.learn(load, 0.6, np.array([True, False, False]))
    memory.learn(0.01 * load, 0.006, np.ones(3, dtype=bool))
    for name in ("ratio", "variance"):
        np.testing.assert_array_equal(memory.ratios[name], start[name])
    memory.learn(load, 0.6, np.array([False, True, True]))
    assert memory.ratio[0] == 1.0
    assert memory.variance[0] == start["variance"][0]
    assert memory.variance[1] < start["variance"][1]


def test_permuted_drives_give_permuted_memory():
    ratios, order = np.array([0.95, 1.0, 1.05]), np.array([2, 0, 1])
    straight, turned = learnt(ratios, 1.0, noise=0.0), learnt(ratios[order], 1.0, noise=0.0)
    assert turned.ratio == pytest.approx(straight.ratio[order])


def heard(load, command, before=None, age_s=0.0, excess=0.0):
    n = len(load)
    before = command if before is None else before
    return response.Heard(
        *(np.array(load, dtype=float) for _ in range(2)),
        np.full(n, excess),
        *(np.array(column, dtype=float) for column in (command, before)),
        np.full(n, age_s),
        np.ones(n, dtype=bool),
    )


def say(what, ticks=1, memory=None):
    memory = memory or Responses(len(what.load), SPREAD)
    for _ in range(ticks):
        lost, _ = memory.respond(what, 0.01)
    return memory, lost


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_behind_its_command_is_a_loss_in_either_direction(sign):
    _, lost = say(heard([sign * 0.6, sign * 0.3, 0.0], [sign * 0.6] * 3), ticks=4)
    assert lost[0] < 0.05
    assert np.all(lost[1:] > 0.99)


def test_a_deficit_counts_only_with_a_younger_command():
    memory, lost = say(heard([0.2], [0.6], age_s=0.09), ticks=8)
    assert lost[0] == response.OPEN
    _, lost = say(heard([0.2], [0.6], age_s=0.05), memory=memory)
    assert lost[0] > 0.99
    _, lost = say(heard([0.2], [0.2], [0.3], age_s=0.005), memory=memory)
    assert lost[0] < 0.05, "the command has followed: it was no loss"


def test_a_sudden_loss_is_told_by_the_rotor_it_sets_free():
    old = {"age_s": 0.09}
    _, lost = say(heard([0.1], [0.6], excess=0.2, **old))
    assert lost[0] > 0.99
    memory, lost = say(heard([0.1], [0.6], excess=-0.2, **old))
    assert lost[0] == response.OPEN, "the rotor slowed down: the torque went first"
    _, lost = say(heard([0.1], [0.6], excess=0.2, **old), ticks=2, memory=memory)
    assert lost[0] > 0.99
    _, lost = say(heard([0.4], [0.6], excess=0.2, **old))
    assert lost[0] == response.OPEN, "so little may be noise"
    slow, _ = say(heard([0.4], [0.6], **old), ticks=4)
    _, lost = say(heard([0.1], [0.6], excess=0.2, **old), memory=slow)
    assert lost[0] == response.OPEN, "a load that falls slowly may be the train's"
    sudden, _ = say(heard([0.1], [0.6], excess=0.2, **old))
    _, lost = say(heard([0.1], [0.6], **old), ticks=3, memory=sudden)
    assert lost[0] > 0.99, "what was told stands while the deficit stands"


@pytest.mark.parametrize(
    ("command", "before"), [(0.6, 0.3), (0.3, 0.6), (0.2, -0.2), (0.05, 0.05), (0.0, 0.0)]
)
def test_commands_on_their_way_accuse_nobody(command, before):
    slowest = min((command, before, 2 * command - before), key=abs)
    lost, meant = Responses(1, SPREAD).respond(heard([slowest], [command], [before]), 0.01)
    assert lost[0] < 0.5 if meant[0] else lost[0] == response.OPEN
    assert meant[0] == (0.0 < before < 2 * command and command >= 0.1)


def test_load_over_command_is_learnt_from_steady_commands_only():
    memory = Responses(2, SPREAD)
    everyone = np.ones(2, dtype=bool)
    for age_s in (0.0, 0.05) * 100:
        # Half a command cycle later it may long have changed: that is not learnt.
        load = [0.55, 0.55] if age_s == 0.0 else [0.1, 0.1]
        what = heard(load, [0.6, 0.6], [0.6, 0.3], age_s)
        memory.learn_response(what, everyone, 0.01)
    assert memory.ratio[0] == pytest.approx(0.55 / 0.6, abs=0.01)
    assert memory.ratio[1] == 1.0


def test_a_response_outvotes_a_comparison_only_where_it_is_sure():
    compared = Opinion(
        np.array([0.99, 0.99, 0.99, 0.1, 0.995, 0.99, 0.01]), np.ones(7, dtype=bool), 0.6
    )
    alone = np.array([0.01, 0.2, 0.01, 0.99, 0.01, response.OPEN, response.OPEN])
    zero, asked = np.zeros(7), np.full(7, 0.6)
    everyone = response.Heard(asked, asked, zero, asked, asked, zero, np.ones(7, dtype=bool))
    meant = np.array([True, True, False, True, True, False, False])
    away = np.array([False, False, False, False, False, True, True])
    lost, _ = Responses(7, SPREAD).fuse(everyone, compared, alone, away, meant)
    # The third command is on its way through zero: nothing accuses. So are the last two, but their
    # rotors run away: what accuses does, nothing clears.
    assert lost.tolist() == [
        response.VETOED, 0.99, response.OPEN, 0.99, 0.995, 0.99, response.OPEN,
    ]  # fmt: skip


def test_a_drive_that_coasts_is_known_by_the_comparison_only():
    compared = Opinion(np.array([0.2, 0.2]), np.array([True, False]), 0.6)
    zero, asked = np.zeros(2), np.full(2, 0.05)
    coasts = response.Heard(zero, zero, zero, asked, asked, zero, np.ones(2, dtype=bool))
    alone, meant = np.full(2, response.OPEN), np.zeros(2, dtype=bool)
    lost, known = Responses(2, SPREAD).fuse(coasts, compared, alone, meant, meant)
    assert known.tolist() == [True, False]
    assert lost[0] == 0.2
