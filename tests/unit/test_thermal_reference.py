"""The thermal core equals its NumPy forms, on random, extreme and missing numbers."""

import math

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc import records
from dbc.records import pointer
from estimators.thermal import hypotheses, model, step_detector
from estimators.thermal.hypotheses import BENIGN_K, SIZES_K, SNAPSHOTS, TAIL, Spread
from tests import thermal_core as core
from tests.core_calls.step_detector import offsets
from tests.reference import hypotheses as reference_hypotheses
from tests.reference import imm as reference_imm
from tests.reference import step_detector as reference_steps


def backward_euler(p, square, speed, ambient, extra, dt, x):
    """One step of the five equations as one dense linear system."""
    a = model.system_matrix(p, square, speed)
    heat = np.zeros(5)
    heat[0] = p[model.A] * square * (1.0 - 0.0039 * 60.0)
    heat[1] = p[model.E_1] * speed + p[model.E_2] * speed**2
    heat[2] = (p[model.H_0] + p[model.H_1] * speed) * ambient
    heat[3] = p[model.F_D] * speed + p[model.B_D] * ambient
    heat[4] = p[model.F_N] * speed + p[model.B_N] * ambient
    return np.linalg.solve(np.eye(5) - dt * a, x + dt * (heat + extra))


@pytest.mark.parametrize("dt", [1e-3, 1.0, 60.0, 36_000.0])
def test_a_step_is_backward_euler(dt):
    rng = np.random.default_rng(int(dt))
    for _ in range(100):
        p = model.TYPICAL * np.exp(0.5 * rng.standard_normal(model.COUNT))
        square, speed = rng.uniform(0.0, 1e5), rng.uniform(0.0, 500.0)
        square = min(square, 0.5 / (0.0039 * p[model.A] * dt))
        extra, x = rng.normal(0.0, 0.1, 5), rng.uniform(-40.0, 300.0, 5)
        want = backward_euler(p, square, speed, -12.0, extra, dt, x)
        core.step(p, square, speed, -12.0, extra, dt, x)
        np.testing.assert_allclose(x, want, rtol=1e-9, atol=1e-9)


def test_a_simulation_is_its_steps_and_resistance_is_coppers():
    rng = np.random.default_rng(1)
    inputs = model.Inputs(
        rng.uniform(0.0, 4e4, (50, 2)), rng.uniform(0.0, 300.0, 50), rng.uniform(-5.0, 30.0, 50),
        np.array([0, 3, 3, 40]), 10.0,
    )  # fmt: skip
    p, extra = np.tile(model.TYPICAL, (2, 1)), rng.normal(0.0, 1e-3, (2, 5))
    state = rng.uniform(20.0, 80.0, (2, 5))
    x = state.copy()
    got = model.run(p, inputs, extra, state)
    for n in range(41):
        for m in range(2):
            core.step(
                p[m], inputs.current_square[n, m], inputs.speed[n], inputs.ambient[n], extra[m],
                10.0, x[m],
            )  # fmt: skip
        for k in np.flatnonzero(inputs.at == n):
            np.testing.assert_array_equal(got[k], x)
    np.testing.assert_array_equal(state, x)
    np.testing.assert_allclose(model.resistance(np.array([[60.0, 160.0]])), [[1.0, 1.39]])


def residuals(kind, rng, k=400):
    x = 0.25 * rng.standard_normal(k)
    if kind == "steps":
        for at in rng.integers(50, k, 6):
            x[at:] += rng.choice([-8.0, -2.0, 2.0, 3.0, 40.0])
    if kind == "heat":
        x += np.interp(np.arange(k), [100, 150, 300, 350], [0.0, 20.0, 20.0, 0.0])
    if kind == "bursts":
        for at in rng.integers(50, k, 12):
            x[at : at + 6] += 25.0
    if kind == "extreme":
        x[rng.random(k) < 0.3] *= 1e6
    x[rng.random(k) < rng.choice([0.0, 0.1, 0.6])] = np.nan
    gap = int(rng.integers(0, k))
    x[gap : gap + int(rng.integers(0, 80))] = np.nan
    return x


def followed(x, spacing=1.0):
    """Offsets of a residual (K,), which are the reference's to the bit."""
    found, want = step_detector.config(spacing)[0], np.zeros((len(x), 1))
    counts = np.array([found["before"], found["after"], found["settled"]])
    reference_steps.follow(x[:, None], counts, 1.5, 1.0, 0.1 * spacing, want)
    np.testing.assert_array_equal(offsets(x[:, None, None], spacing)[:, :, 0], want)
    return want[:, 0]


@pytest.mark.parametrize("kind", ["quiet", "steps", "heat", "bursts", "extreme"])
@pytest.mark.parametrize("spacing", [2.0, 1.0])
def test_steps_equal_the_reference_to_the_bit(kind, spacing):
    rng = np.random.default_rng([len(kind), int(spacing)])
    for _ in range(12):
        followed(residuals(kind, rng), spacing)


def test_a_step_behind_a_gap_of_any_length_equals_the_reference():
    rng, found, met = np.random.default_rng(7), step_detector.config(1.0)[0], set()
    for gap in range(2 * found["settled"] + found["before"]):
        x = 50.0 + 0.25 * rng.standard_normal(250)
        x[100:] += 3.0
        x[100 : 100 + gap] = np.nan
        met.add(bool(followed(x)[-1]))
    assert met == {False, True}


@pytest.mark.parametrize(
    ("then", "later", "offset"), [(1.5, 1.5, 0.0), (3.0, 0.8 * 1.5, 0.0), (3.0, 1.0, 1.0)]
)
def test_exactly_on_a_limit_it_equals_the_reference(then, later, offset):
    """A step of 1.5 K is none, nor is one that settles at 0.8 of it; an offset of 1 K is one."""
    x = np.zeros(300)
    x[100:105], x[105:] = then, later
    if offset:
        x[105:200] = then
    assert followed(x)[-1] == offset


def test_behind_the_last_sample_nothing_is_written():
    x, out = np.zeros(50), np.full(50, 7.0)
    config = pointer("struct step_config", step_detector.config(1.0))
    lib.step_follow(config, pointer("double", x), 49, pointer("double", out))
    assert out.tolist() == [0.0] * 49 + [7.0]


def test_samples_too_close_together_are_refused():
    with pytest.raises(ValueError, match="too close together"):
        offsets(np.zeros((10, 1, 1)), 0.01)


@pytest.mark.parametrize("seed", range(4))
def test_the_interacting_filters_equal_the_reference(seed):
    """Hundreds of blocks: quiet ones, faults, absurd numbers, no readings; held and not."""
    rng = np.random.default_rng(seed)
    dt, noise = float(rng.choice([16.0, 60.0])), float(rng.choice([0.02, 0.1, 1.0]))
    config = core.config(dt)
    own = core.started(config)
    mode, mean, cov = (own[name][0].copy() for name in ("mode", "mean", "cov"))
    odds = np.array([1 / 36_000, 1 / 3600, 900.0, 0.6, 0.2, 0.03, 0.02, 5.0, 0.3, 0.3])
    p = model.TYPICAL * np.exp(0.3 * rng.standard_normal(model.COUNT))
    kind = np.empty(8)
    for k in range(250):
        rates = model.system_matrix(p, rng.uniform(0.0, 4e4), rng.uniform(0.0, 400.0))
        pushes, heats = 0.01 * rng.random((5, 5)), 0.003 * rng.random((5, 5))
        around = core.surroundings(rates, pushes, heats, rise := float(rng.uniform(3.0, 80.0)))
        y = 0.1 * rng.standard_normal(3) + (k > 60) * np.array([0.02, 0.0, 0.0]) * (k - 60)
        y *= 10.0 ** rng.uniform(0.0, 4.0) if rng.random() < 0.05 else 1.0
        y[rng.random(3) < 0.2] = np.nan
        held = bool(k % 3 == 0)
        want = reference_imm.advance(
            mode, mean, cov, y, rates, pushes, heats, rise, dt, config["sigma"][0], odds,
            core.SIZES_K, noise, held,
        )  # fmt: skip
        got = core.advance(config, around, y, noise, own, held)
        assert got == pytest.approx(want, rel=1e-7, abs=1e-7), k
        np.testing.assert_allclose(own["mode"][0], mode, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(own["mean"][0], mean, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(own["cov"][0], cov, rtol=1e-5, atol=1e-6)
        size = reference_imm.tell(mode, mean, cov, config["benign_k"][0], 0.6, kind)
        kinds, size_k = core.kinds(config, own)
        np.testing.assert_allclose(kinds, kind, rtol=1e-5, atol=1e-12)
        assert size_k == pytest.approx(size, rel=1e-5)


def test_a_stiff_motor_and_one_that_is_no_motor_have_a_response():
    """However stiff, doublings are bounded; numbers that are none stay none."""
    fade, _ = core.response(-1e3 * np.eye(5), 1e3)
    np.testing.assert_allclose(fade, 0.0, atol=1e-12)
    fade, _ = core.response(np.full((5, 5), math.inf), 1.0)
    assert np.isnan(fade).any()


@pytest.mark.parametrize("motors", [1, 2, 3, 4, 7, 16])
def test_the_peers_median_equals_the_reference_to_the_bit(motors):
    rng = np.random.default_rng(motors)
    for k in range(300):
        u = rng.normal(0.0, 3.0, (motors, 3)).round(k % 3)
        u[rng.random(u.shape) < rng.choice([0.0, 0.3, 0.9])] = np.nan
        trusted = rng.random(motors) < rng.choice([1.0, 0.6, 0.0])
        want = np.empty_like(u)
        reference_hypotheses.references(u, trusted, want)
        np.testing.assert_array_equal(hypotheses.peers_median(u, trusted), want)


@pytest.mark.parametrize("motors", [1, 2, 5])
def test_hypotheses_equal_the_reference(motors):
    rng = np.random.default_rng(motors)
    samples = 40
    z = rng.normal(0.0, 0.4, (samples, motors, 3))
    z[15:, motors - 1] += rng.choice([0.0, 6.0, -9.0], 3)
    z[rng.random(z.shape) < 0.1] = np.nan
    z[30, 0, 0], z[33, 0, 1] = 1e6, 1e80
    root = np.eye(3) + 0.3 * rng.standard_normal((motors, 3, 3))
    known = Spread(
        np.zeros((motors, 3)), rng.uniform(0.2, 1.0, (motors, 3)), 2.0 * root,
        rng.uniform(0.05, 1.0, (motors, 3)),
    )  # fmt: skip
    shapes = rng.uniform(0.0, 1.0, (samples, 5, 3))
    kind, size, rise = np.empty((samples, motors, 11)), *np.empty((2, samples, motors))
    at = SNAPSHOTS
    rates = np.array([
        1 / at.healthy, 1 / at.ill, 1 / at.grows, TAIL, hypotheses.LOOSE_SHARE, hypotheses.LOOSE_K,
        1 / at.often, 1 / at.learnt, 1 / at.loose,
    ])  # fmt: skip
    reference_hypotheses.sweep(
        z, known.sigma, known.white, known.share, shapes, SIZES_K, BENIGN_K, rates, kind, size,
        rise,
    )  # fmt: skip
    got = hypotheses.filter_samples(z, known, shapes, at)
    for ours, theirs in zip(got, (kind, size, rise), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-11)


def test_what_is_wrong_to_size_is_nothing_where_nothing_is_wrong():
    """A mean over no probability."""
    own = np.zeros(1, records.IMM_STATE)
    assert core.kinds(core.config(16.0), own)[1] == 0.0
    state = ffi.new("struct hypothesis_state *")
    lib.hypothesis_start(state)
    assert (state.p[0], state.held, state.trusted) == (1.0, -1, 1)
    assert len(pointer("double", np.zeros(3))) == 3


def test_heat_or_a_sensor_is_said_where_one_of_them_is_as_sure_as_asked():
    """A loose connector is a sensor's, and nothing at all is no heat."""
    rng = np.random.default_rng(4)
    kind = rng.dirichlet(np.full(11, 0.2), 2000)
    kind[:50] = 0.0
    hot, off, loose = kind[:, :5].sum(1), kind[:, 5:8].sum(1), kind[:, 8:].sum(1)
    heat = hot >= 0.8 * (hot + off)
    sensor = (hot <= 0.2 * (hot + off)) | (loose > hot + off)
    want = np.where(sensor, -1, np.where(heat, 1, 0))
    np.testing.assert_array_equal(hypotheses.side(kind, 0.8), want)
    assert set(want.tolist()) == {-1, 0, 1}
