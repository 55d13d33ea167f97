"""Wheels that grip again: beside drives that hold their torque back, and with large inertia."""

import pytest

from gateway.study.evaluation_runs import Plan, one_run
from tests.thorough import some

FAMILY = "roller_varied"


@pytest.mark.parametrize("seed", some([5], [20, 55]))
def test_torque_that_a_drive_takes_back_after_a_regrip_is_no_new_loss(seed):
    (run,) = one_run(Plan((FAMILY,), ("switching",), (seed,), world="roller"), FAMILY, seed)
    assert run.flags.losses
    assert not run.flags.missed
    assert run.flags.alarms == 0


@pytest.mark.parametrize(("world", "family", "seed", "f1", "adhering"), [
    ("ours", "rough", 310, 0.95, 0.99),  # not known for one tick, just when its load is lost
    ("ours", "healthy_rough", 306, 1.0, 0.99),  # Motion that is constant beside noisy currents
    ("roller", "roller", 304, 0.95, 0.97),  # half a second with twice the load of the others
    ("roller", "roller_two", 303, 0.85, 0.85),  # the other of two drives is no measure any more
])  # fmt: skip
def test_wheels_with_the_inertia_of_a_locomotive(world, family, seed, f1, adhering):
    plan = Plan((family,), ("switching",), (seed,), motor="traction_350kw", world=world)
    (run,) = one_run(plan, family, seed)
    assert run.flags.f1 >= f1
    assert run.flags.good_share >= adhering
    assert (run.flags.missed, run.flags.dangerous) == (0, 0)


@pytest.mark.parametrize("seed", some([301], [305, 329, 334, 335]))
def test_of_two_drives_the_one_that_held_is_not_accused_while_the_other_grips_again(seed):
    """Three times the load for a tenth of a second, while a large inertia gives back its speed."""
    plan = Plan(("roller_two",), ("switching",), (seed,), motor="traction_350kw", world="roller")
    (run,) = one_run(plan, "roller_two", seed)
    assert run.flags.losses == 1
    assert (run.flags.missed, run.flags.alarms, run.flags.dangerous) == (0, 0, 0)
