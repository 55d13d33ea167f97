import numpy as np
import pytest

from sim.physics import thermal
from sim.physics.plant import BENCH, MOTORS
from sim.physics.thermal import (
    BEARING_DE,
    BEARING_NDE,
    CAPACITY,
    FRAME,
    LINKS,
    NODES,
    STEP_NS,
    WINDING,
    ThermalTrain,
)
from sim.records import ffi, lib, pointer

I2 = np.full(3, 15.0**2)
W = np.full(3, 25.0)
NO_HEAT = np.zeros((3, NODES))
COOLED = np.zeros(3)


def settled():
    train = ThermalTrain(BENCH, 3, 20.0, 1)
    train.settle(I2, W)
    return train


def run(train, seconds, heat=NO_HEAT, lost=COOLED):
    for _ in range(round(seconds * 1e9) // STEP_NS):
        train.advance(I2, W, heat, lost)
    return train


def test_settled_motor_stays_and_is_warm():
    train = settled()
    before = train.temperatures.copy()
    run(train, 20.0)
    np.testing.assert_allclose(train.temperatures, before, atol=1e-6)
    assert np.all(before[:, WINDING] > before[:, FRAME])
    assert np.all(before[:, FRAME] > 25.0)
    assert np.all(before[:, BEARING_DE] > 22.0)
    assert np.all(before[:, WINDING] < 120.0)


def test_a_step_equals_the_matrix_form():
    rng = np.random.default_rng(1)
    state = rng.uniform(10, 90, (4, NODES))
    link = rng.uniform(0, 5, (4, NODES, NODES + 1))
    sources = rng.uniform(0, 100, (4, NODES))
    air = rng.uniform(0, 30, 4)
    ones = np.concatenate([state, air[:, None]], axis=1)
    flow = np.einsum("mab,mb->ma", link, ones) - link.sum(axis=2) * state + sources
    expected = state + 0.01 * flow / CAPACITY
    thermal.heat_step(state, sources, link, CAPACITY, air, 0.01)
    np.testing.assert_allclose(state, expected, rtol=1e-13)


@pytest.mark.parametrize("fault", [(-1, -1), (1, 2)])
def test_a_record_equals_the_matrix_form(fault):
    rng = np.random.default_rng(2)
    steps, motors, at = 50, 3, np.array([0, 7, 7, 49])
    copper, rub, cooling, air = rng.uniform(1, 50, (4, steps, motors))
    iron, heat = rng.uniform(1, 50, (2, steps))
    links = rng.uniform(0, 5, (NODES, NODES))
    state = rng.uniform(10, 90, (motors, NODES))
    expected, kept = state.copy(), []
    for k in range(steps):
        q = expected @ links.T - links.sum(axis=1) * expected
        q[:, WINDING] += copper[k] * (1.0 + 0.004 * (expected[:, WINDING] - 60.0))
        q[:, 1] += 0.8 * iron[k]
        q[:, 5] += 0.2 * iron[k]
        q[:, FRAME] += cooling[k] * (air[k] - expected[:, FRAME])
        q[:, 3:5] += rub[k][:, None] + 0.25 * (air[k][:, None] - expected[:, 3:5])
        if fault[0] >= 0:
            q[fault] += heat[k]
        expected += 0.5 * q / CAPACITY
        kept += [expected.copy()] * np.count_nonzero(at == k)
    out = np.empty((len(at), motors, NODES))
    courses = (pointer("double", x) for x in (copper, iron, rub, cooling, air, heat))
    record = ffi.new("struct sim_heat_record *", [
        steps, motors, len(at), 0.5, 0.25, 0.2, 0.004, 60.0, *courses, *fault,
        pointer("double", links), pointer("double", CAPACITY), pointer("int64_t", at),
    ])  # fmt: skip
    lib.sim_heat_record(record, pointer("double", state), pointer("double", out))
    np.testing.assert_allclose(out, kept, rtol=1e-12)
    np.testing.assert_allclose(state, expected, rtol=1e-12)


def test_heat_is_conserved_without_air():
    train = settled()
    train._link[:, :, NODES] = 0.0
    train._cooling = lambda *_: None
    before = train.temperatures.copy()
    heat = NO_HEAT.copy()
    heat[1, WINDING] = 200.0
    run(train, 5.0, heat)
    gained = ((train.temperatures - before) * CAPACITY).sum(axis=1)
    assert gained[1] - gained[0] == pytest.approx(200.0 * 5.0, rel=0.05)


def test_overheating_warms_the_winding_of_one_motor_and_not_its_twin():
    train = settled()
    heat = NO_HEAT.copy()
    heat[1, WINDING] = 200.0
    run(train, 10.0, heat)
    effect = train.temperatures - train.healthy
    assert 3.0 < effect[1, WINDING] < 4.4
    assert 0.0 < effect[1, BEARING_DE] < 0.1
    np.testing.assert_array_equal(effect[[0, 2]], 0.0)


def test_bearing_warms_one_end():
    train = settled()
    heat = NO_HEAT.copy()
    heat[2, BEARING_DE] = 40.0
    run(train, 20.0, heat)
    effect = (train.temperatures - train.healthy)[2]
    assert 3.5 < effect[BEARING_DE] < 5.4
    assert effect[BEARING_NDE] < 0.1
    assert effect[WINDING] < 0.05


def test_cooling_loss_lifts_all_points_slowly():
    train = settled()
    run(train, 60.0, NO_HEAT, np.array([1.0, 0.5, 0.0]))
    effect = train.temperatures - train.healthy
    points = list(thermal.MEASURED)
    assert np.all(effect[0, points] > 0.25)
    assert np.all(effect[0, points] > 1.5 * effect[1, points])
    np.testing.assert_array_equal(effect[2], 0.0)


def test_stated_time_constants():
    conduct = np.zeros((NODES, NODES))
    for a, b, g in LINKS:
        conduct[a, b] = conduct[b, a] = g
    air = np.array([0, 0, 7.5, 0.25, 0.25, 0])
    rates = (np.diag(conduct.sum(axis=1) + air) - conduct) / CAPACITY[:, None]
    tau = np.sort(1.0 / np.linalg.eigvals(rates).real)
    assert tau[0] > 20.0
    assert 600.0 < tau[-1] < 700.0
    assert CAPACITY[WINDING] == pytest.approx(8.0 * 56.0, rel=0.02)


def test_the_same_train_every_time_but_unlike_motors():
    one, two = settled(), settled()
    np.testing.assert_array_equal(one.temperatures, two.temperatures)
    assert len({round(float(t), 3) for t in one.temperatures[:, WINDING]}) == 3
    other = ThermalTrain(BENCH, 3, 20.0, 2)
    other.settle(I2, W)
    assert not np.allclose(one.temperatures, other.temperatures)


def test_larger_motor_scales():
    large = ThermalTrain(MOTORS["large"], 1, 20.0, 1)
    large.settle(np.array([30.0**2]), np.array([25.0]))
    assert 25.0 < large.temperatures[0, WINDING] < 120.0


def test_uniform_start():
    train = ThermalTrain(BENCH, 2, 20.0, 1)
    train.set_uniform(55.0)
    assert np.all(train.temperatures == 55.0)
