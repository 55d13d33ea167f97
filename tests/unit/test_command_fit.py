"""Whether a command is what the train asks for, or what its drive has made of it."""

import numpy as np
import pytest

from gateway.mapping.command_fit import Commanded, fell_alone, repeats_torque

T = np.arange(100) * 0.1
RATED_NM = 30.0


def demand(t=T):
    """Up, steady, down, in steps of 0.1 Nm."""
    return np.round(np.interp(t, [0.0, 2.0, 7.0, 9.0], [0.0, 20.0, 20.0, 5.0]), 1)


def noisy(course, seed=1):
    return np.round(course + np.random.default_rng(seed).normal(0.0, 0.8, len(course)), 1)


def drive(command, torque, node=1):
    return Commanded(node, T, command, torque, RATED_NM)


def test_a_command_with_the_noise_of_the_torque_is_found():
    torque = noisy(demand())
    (found,) = repeats_torque(drive(torque, torque))
    assert found.fits is False
    assert "repeats Torque" in found.text


@pytest.mark.parametrize("torque", [noisy(demand()), demand(), np.full(100, np.nan)],
                         ids=["noise", "none", "unknown"])  # fmt: skip
def test_a_command_that_is_asked_for_is_not(torque):
    assert not list(repeats_torque(drive(demand(), torque)))


def test_too_few_commands_say_nothing():
    torque = noisy(demand())[:20]
    assert not list(repeats_torque(Commanded(1, T[:20], torque, torque, RATED_NM)))


def test_a_command_that_falls_alone_with_its_torque_is_named():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 5.0))
    drives = [drive(demand(), noisy(demand()), 1), drive(fallen, noisy(fallen), 2),
              drive(demand(), noisy(demand(), 3), 3)]  # fmt: skip
    found = fell_alone(drives)
    assert list(found) == [2]
    assert found[2].fits is None
    assert "alone 3." in found[2].text
    assert "from 20 to 5 Nm" in found[2].text
    backwards = [one._replace(command=-one.command, torque=-one.torque) for one in drives]
    assert list(fell_alone(backwards)) == [2]
    assert fell_alone(drives[1:]) == {}


def test_commands_that_fall_together_and_a_torque_that_falls_alone_are_fine():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 5.0))
    assert fell_alone([drive(fallen, noisy(fallen), n) for n in (1, 2, 3)]) == {}
    drives = [drive(demand(), noisy(fallen if n == 2 else demand()), n) for n in (1, 2, 3)]
    assert fell_alone(drives) == {}
    silent = [one._replace(t=T[:0], command=T[:0], torque=T[:0]) for one in drives]
    assert fell_alone(silent) == {}
