"""No number on the wire raises: extreme but legal raw values through the whole core.

`make test-all` runs all set-ups, under sanitizers too, where
a conversion or an index that a number could break ends the run.
"""

from itertools import product

import numpy as np
import pytest

from gateway.core.gateway import Gateway
from tests import extremes
from tests.extremes import RULES, Setup, Stretch, changed, run, stretches
from tests.stations import last_samples, receive
from tests.value_cases import honest

SETUPS = [
    Setup(drives, kind, fd, speed)
    for drives, kind, fd, speed in product((1, 2, 3), ("ekf", "ukf"), (False, True), (100.0, 290.0))
] + [Setup(16, kind, fd, 200.0) for kind, fd in product(("ekf", "ukf"), (False, True))]
QUICK = {Setup(1, "ekf", False, 290.0), Setup(2, "ukf", True, 100.0)}
SOME = {*QUICK, Setup(3, "ekf", False, 100.0)}


def _marks(setup):
    """Some are for every change; `make test-all` has them all."""
    if setup in QUICK:
        return ()
    return (pytest.mark.slow,) if setup in SOME else (pytest.mark.slow, pytest.mark.thorough)


@pytest.mark.parametrize(
    "setup", [pytest.param(s, marks=_marks(s), id="-".join(map(str, s[:4]))) for s in SETUPS]
)
def test_nothing_that_drives_say_raises(setup):
    wanted = stretches(setup)
    if setup.drives > 3:
        wanted = [s for s in wanted if s.message in ("electrical", "all")]
    assert not run(setup, wanted)


@pytest.mark.parametrize("detector", ["median", "kmeans", "vmp"])
def test_nor_with_another_detector(detector):
    setup = Setup(2, "ekf", False, 290.0, detector=detector)
    assert not run(setup, [s for s in stretches(setup) if s.message in ("electrical", "all")])


@pytest.mark.slow
def test_nor_with_a_thermal_model():
    """Readings of temperatures come ten times a second: for longer."""
    setup = Setup(3, thermal=True)
    wanted = [s for s in stretches(setup) if s.message in ("Temperatures", "Status", "all")]
    assert not run(setup, wanted, lengths=(200, 100))


class _Divides(Gateway):
    """By what a current has moved in a tick."""

    def step(self, frames, now):
        out = super().step(frames, now)
        assert 1.0 / float(np.ptp(last_samples(self.inbox).y[:5, 0])) > 0.0
        return out


def test_a_gateway_that_raises_is_found_and_the_stretch_is_named():
    setup = Setup(1)
    wanted = [Stretch("held", "PhaseCurrents", (0,)), Stretch("ends", "Motion", (0,))]
    (raised,) = run(setup, wanted, made=_Divides)
    assert raised.stretch == wanted[0]
    assert raised.error.startswith("ZeroDivisionError")


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("rule", RULES)
def test_what_is_changed_is_decoded_and_counts_on(rule, fd):
    setup = Setup(1, fd=fd)
    blocks = honest(setup.speed, setup.motor, fd, 40, 0.6, setup.nodes)
    core = Gateway(setup.config(), setup.codec, 0)
    made = list(changed(setup, Stretch(rule, "all", (0,)), blocks, 1))
    assert any((a.data != b.data).any() for a, b in zip(made, blocks, strict=True))
    for tick, block in enumerate(made, start=1):
        receive(core.inbox, block, tick * extremes.TICK)
    counts = core.inbox.counts
    used = counts["decoded"] + counts["not_available"] + counts["range"]
    assert used >= 0.95 * (counts["received"] - counts["canopen"])
    assert not counts["error"] + counts["repeated"] + counts["wrong_sequence"]
