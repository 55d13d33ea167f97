"""Residuals of motors equal their NumPy form: with gaps, steps and missing readings."""

from types import SimpleNamespace

import numpy as np
import pytest
from _traction_core import lib

from dbc import records
from dbc.records import pointer
from estimators.thermal import model, step_detector
from estimators.thermal.monitor import Known, ThermalMonitor
from tests import thermal_core as core
from tests.reference.residuals import Motor, less_steps

MOTORS, GAP_S, BLOCK = 3, 20.0, 15
SUMS = "current_square", "speed", "cooling", "copper", "rise", "count"


def train(rng, tested):
    """A monitor, its motors' reference forms."""
    p = model.TYPICAL * np.exp(0.2 * rng.standard_normal((MOTORS, model.COUNT)))
    p[:, model.OFFSETS] = rng.normal(0.0, 2.0, (MOTORS, 3))
    centre = rng.normal(0.0, 1.0, (MOTORS, 3))
    duty = np.array([200.0, 2e4, 0.03, 0.08])
    monitor = ThermalMonitor(Known(p, centre, 0.25 + 0.0 * centre, 1.0, duty), 1.0)
    monitor.config["gap_s"], monitor.config["block"] = GAP_S, BLOCK
    monitor.config["steps"] = steps = step_detector.config(1.0, tested=tested)
    config = SimpleNamespace(
        dt_s=1.0, gap_s=GAP_S, block=BLOCK, window=step_detector.window(steps),
        **{name: steps[name].item() for name in ("before", "after", "step_k", "back_k", "drift_k")},
    )  # fmt: skip
    return monitor, [Motor(*both, config) for both in zip(p, centre, strict=True)]


def weather(rng, samples):
    """Readings (K, M, 3), and inputs (3, K, M): steps of sensors, readings and inputs missing."""
    reading = rng.uniform(-20.0, 140.0, (1, MOTORS, 3)) + rng.normal(0, 0.2, (samples, MOTORS, 3))
    for at in rng.integers(30, samples, 8):
        reading[at:, rng.integers(MOTORS), rng.integers(3)] += rng.choice([-9.0, 5.0])
    reading[rng.random(reading.shape) < 0.1] = np.nan
    reading[:3, 0], reading[:40, 1, 1:], reading[:60, 2, rng.integers(3)] = np.nan, np.nan, np.nan
    changes = rng.uniform([[[0.0]], [[0.0]], [[-20.0]]], [[[4e4]], [[400.0]], [[30.0]]],
                          (3, samples // 40 + 1, MOTORS))  # fmt: skip
    inputs = np.repeat(changes, 40, axis=1)[:, :samples]
    for m, gap in enumerate((int(GAP_S), int(GAP_S) + 1, 5)):
        for at in rng.integers(20, samples, 2):
            inputs[rng.integers(3), at : at + gap, m] = np.nan
    return reading, inputs.transpose(1, 0, 2)


@pytest.mark.parametrize("tested", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_residuals_equal_the_reference(seed, tested):
    rng = np.random.default_rng(seed)
    monitor, plain = train(rng, tested)
    own, met = monitor.motors, set()
    fresh = core.started(monitor.config["imm"])["cov"][0, :, model.CORE, model.CORE]
    for n, (reading, given) in enumerate(zip(*weather(rng, 300), strict=True)):
        k, inputs = n % BLOCK, np.empty(MOTORS, records.THERMAL_INPUT)
        inputs["current_square"], inputs["speed"], inputs["ambient"] = given
        current = monitor.currents
        current["cut_out"] = np.arange(MOTORS) == n // 45 - 1
        monitor.record["position"] = k
        own["peers_k"] = peers = rng.choice([-8.0, 0.0, 5.0, np.nan], (MOTORS, 3))
        lib.thermal_add_sample(
            monitor.pointer, pointer("double", reading.copy()),
            pointer("struct thermal_input", inputs),
        )  # fmt: skip
        for m, one in enumerate(plain):
            one.peers = peers[m]
            one.add(k, reading[m], *given[:, m], bool(current["cut_out"][m]))
        without = less_steps(plain)
        for m, one in enumerate(plain):
            np.testing.assert_allclose(own["raw"][m, :, k], one.raw, atol=1e-9)
            np.testing.assert_allclose(own["block"][m, :, k], without[m], atol=1e-9)
            np.testing.assert_allclose(
                np.array([own["half"][name][m] for name in SUMS]).T, one.half, rtol=1e-9
            )
            cov = own["imm"]["cov"][m, :, model.CORE, model.CORE]
            np.testing.assert_allclose(cov, fresh + 0.25 * one.span**2, rtol=1e-9)
            assert (own["unknown_s"][m], own["started"][m], own["lost"][m]) == (
                one.unknown_s, one.lumps is not None, one.lost,
            )  # fmt: skip
            met.add((bool(one.lost), bool(np.isnan(without[m, np.isfinite(one.raw)]).any())))
    assert met == {(False, False), (True, False), *([(False, True)] if tested else [])}


def test_of_a_motor_that_is_reset_nothing_is_known():
    """But whether its inputs are, what others are compared with, and what it is compared with."""
    monitor, _ = train(np.random.default_rng(1), tested=True)
    own = monitor.motors[:1].copy()
    fresh = own.copy()
    own.view(np.uint8)[:] = 1
    names = ("unknown_s", "cold_s", "trusted", "lost", "compared_k", "absent_s", "peers_k")
    kept = {name: own[name] for name in names}
    for name, value in kept.items():
        fresh[name] = value
    for name in ("middle_k", "off_k", "window", "block", "raw"):
        fresh[name] = np.nan
    fresh["step"]["level_k"] = fresh["step"]["home_k"] = fresh["burst"]["level_k"] = np.nan
    lib.thermal_motor_reset(
        pointer("struct thermal_config", monitor.config), pointer("struct thermal_motor", own)
    )
    assert repr(own.tolist()) == repr(fresh.tolist())
