"""How far the monitor's own prediction holds at calibration, and what follows where it does not."""

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import pointer
from estimators.thermal import coverage
from estimators.thermal import model_method as method
from estimators.thermal.model_method import followed
from estimators.thermal.monitor import MOST_FALSE, Coverage, ThermalMonitor
from tests.unit.test_thermal_monitor_order import (
    FLEET,
    MOTORS,
    K,
    healthy_runs,
    known,
    through,
    train,
)

__all__ = ["known"]


@pytest.fixture(scope="module")
def healthy():
    return healthy_runs()


def blocks(known, record):
    """Deviations (B, M, 3) and inputs (B, M) of a record's blocks, and their monitor."""
    monitor, parts = ThermalMonitor(known, 1.0), ["off_k", "inputs"]
    out = [monitor.motors[parts].copy() for judged in followed(monitor, record) if judged]
    return monitor, *(np.array([block[name] for block in out]) for name in ("off_k", "inputs"))


def changed(known, **parts):
    """With a coverage in which all motors are well explained, but for these parts."""
    fine = Coverage(np.ones(MOTORS), np.full((MOTORS, 2), 0.95), np.zeros(MOTORS), np.zeros(MOTORS))
    return known._replace(coverage=fine._replace(**parts))


def test_motors_that_are_the_model_are_covered(known):
    found = known.coverage
    assert not found.unexplained.any()
    assert (found.inflation < 1.1).all()
    assert (found.covered > 0.9).all()
    assert (np.abs(found.lag_one) < 0.2).all()


@pytest.mark.parametrize("missing", [False, True])
def test_the_likelihood_of_the_blocks_is_that_of_the_prediction(known, healthy, missing):
    """The product of every block's density, each given those before it."""
    monitor, off, inputs = blocks(known, healthy[-1])
    monitor.config["imm"]["wide_k"] = 1e45
    off[3:9, 2, 1] = np.nan if missing else off[3:9, 2, 1]
    total = 0.0
    for m, given in enumerate(monitor.held_back(off, inputs)):
        mean, cov = np.empty((len(off), 3)), np.empty((len(off), 3, 3))
        lib.thermal_expected(*given, pointer("double", mean), pointer("double", cov))
        noise = monitor.known_motors["block_noise_k"][m] ** 2
        for k in range(1, len(off)):
            seen = np.flatnonzero(np.isfinite(off[k, m]))
            inner = cov[k][np.ix_(seen, seen)] + noise * np.eye(len(seen))
            error = (off[k, m] - mean[k])[seen]
            total += np.log(0.99) - 0.5 * np.linalg.slogdet(inner)[1]
            total -= 0.5 * error @ np.linalg.solve(inner, error)
    assert monitor.likelihood(off, inputs) == pytest.approx(total, rel=1e-9)
    z = coverage.innovations(monitor, off, inputs)
    np.testing.assert_array_equal(np.isfinite(z), np.isfinite(off))


def test_a_motor_that_spreads_more_than_expected_is_inflated_and_at_last_not_judged(healthy):
    rng = np.random.default_rng(3)
    last = healthy[-1]
    for sigma_k, unexplained in ((0.4, False), (8.0, True)):
        temperature = last.temperature.copy()
        # As long as a block: no median over it helps.
        temperature[:, 2] += sigma_k * np.repeat(rng.standard_normal((K // 20, 3)), 20, axis=0)
        found = method.learn(FLEET, [healthy[0], last._replace(temperature=temperature)]).coverage
        assert found.inflation[2] > 1.1 * np.delete(found.inflation, 2).max()
        assert found.unexplained.tolist() == [False, False, unexplained, False]


def test_a_motor_that_seems_faulty_in_its_own_calibration_is_not_judged(healthy):
    """In its first run: the last one, from which the filters learn, is as the others'."""
    first = healthy[0]
    temperature = first.temperature.copy()
    temperature[len(temperature) // 2 :, 2, 1] += 5.0
    for run, faulty in ((first, False), (first._replace(temperature=temperature), True)):
        found = method.learn(FLEET, [run, healthy[-1]]).coverage
        assert (found.false_share > MOST_FALSE).tolist() == [False, False, faulty, False]
        assert found.unexplained.tolist() == [False, False, faulty, False]
        assert not found.uncovered.any()


def test_too_few_blocks_measure_nothing(known, healthy):
    monitor, off, inputs = blocks(known, healthy[-1])
    few = coverage.START + coverage.FEWEST - 1
    found = coverage.measure(monitor, off[:few], inputs[:few])
    np.testing.assert_array_equal(found.inflation, 1.0)
    assert np.isnan(found.covered).all()
    assert not found.unexplained.any()


def test_an_inflated_filter_is_one_that_expects_so_much_more(known):
    """Of disturbances, lumps and readings alike."""
    by, record = 1.4, train(3)
    one = ThermalMonitor(changed(known, inflation=np.full(MOTORS, by)), 1.0)
    wide = known._replace(scale=by * known.scale, own_k=by * known.own_k, coverage=None)
    two = ThermalMonitor(wide, 1.0)
    two.known_motors["block_noise_k"] *= by
    two.motors[:] = one.motors
    two.config["imm"]["ambiguous"] = one.config["imm"]["ambiguous"]
    ours, theirs = (through(monitor, record).motors["imm"] for monitor in (one, two))
    for name in ("mode", "mean", "cov"):
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9, atol=1e-12)


def test_a_motor_that_is_not_explained_is_not_named_and_not_compared_with(known):
    covered = np.full((MOTORS, 2), 0.95)
    covered[1, 1] = 0.7
    monitor = through(ThermalMonitor(changed(known, covered=covered), 1.0), train(3))
    assert monitor.offsets[1, 1] == pytest.approx(6.0, abs=1.0)
    assert not monitor.kinds()[0][1].any()
    assert np.isfinite(monitor.motors["off_k"]).all(), "it is still compared with the others"
    assert monitor.motors["trusted"].tolist() == [1, 0, 1, 1]
