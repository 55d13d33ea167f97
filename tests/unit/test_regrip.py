"""A wheel that has gripped again beside a drive that still holds its torque back."""

import pytest

from gateway.study.evaluation_runs import Plan, one_run

FAMILY = "roller_varied"


@pytest.mark.parametrize("seed", [5, 20, 55])
def test_torque_that_a_drive_takes_back_after_a_regrip_is_no_new_loss(seed):
    (run,) = one_run(Plan((FAMILY,), ("switching",), (seed,), world="roller"), FAMILY, seed)
    assert run.flags.losses
    assert not run.flags.missed
    assert run.flags.alarms == 0
