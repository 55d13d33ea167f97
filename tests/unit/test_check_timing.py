"""`check`: what it says of the time that a tick takes on this machine."""

import pytest

from gateway.commands import check_timing
from gateway.hil.measured import Measured
from gateway.io.prepare import prepare
from sim.simulation import Simulation
from tests.simrun import run, scenario


@pytest.mark.parametrize(("slow", "note"), [(0, None), (3, "3 of 100 ticks took longer than")])
def test_ticks_that_take_longer_than_the_period_are_named(capsys, slow, note):
    config, codec = prepare(None)
    measured = Measured(config)
    measured.frames = run(Simulation(scenario(), codec), 0.1)
    measured.times_us = [60.0] * (100 - slow) + [10_500.0] * slow
    check_timing.print_results(config, codec, measured)
    out = capsys.readouterr().out
    assert "a tick takes 60 us of 10000 us (1 %)" in out
    assert ("longer than the period" in out) is (note is not None)
    assert note is None or note in out
