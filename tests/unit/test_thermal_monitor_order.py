"""The thermal monitor does not mind order, pace, later samples or absurd ones; what it learns."""

import numpy as np
import pytest

from estimators.thermal import model
from estimators.thermal import model_method as method
from estimators.thermal.model import Inputs, predict
from estimators.thermal.monitor import AMBIGUOUS, MISFIT_K, Coverage, Known, ThermalMonitor
from estimators.thermal.record import Record

MOTORS, K = 4, 2400
TURNED = [2, 0, 3, 1]
NOISE_K = np.random.default_rng(5).uniform(0.1, 0.5, (MOTORS, 3))
FLEET = model.TYPICAL * np.exp(
    0.1 * np.random.default_rng(99).standard_normal((MOTORS, model.COUNT))
)  # fmt: skip


def train(seed, k=K, step_s=1.0, every=1):
    """A record whose sensor 1 of motor 1 steps in the middle; `every` so many steps a sample."""
    rng = np.random.default_rng(seed)
    steps = k * every
    square = np.repeat(rng.uniform(0.0, 4e4, steps // 300 + 1), 300)[:steps]
    square = np.outer(square, 1.0 + 0.01 * np.arange(MOTORS))
    speed = np.repeat(rng.uniform(50.0, 350.0, steps // 300 + 1), 300)[:steps]
    air = np.full(steps, 12.0)
    at = np.arange(1, k + 1) * every - 1
    reading = predict(FLEET, Inputs(square, speed, air, at, step_s))
    reading += NOISE_K * rng.standard_normal(reading.shape)
    reading[k // 2 :, 1, 1] += 6.0
    return Record(reading, at, square, speed, air, step_s)


def turn(record, known):
    swapped = record._replace(
        temperature=record.temperature[:, TURNED], current_square=record.current_square[:, TURNED]
    )
    known = known._replace(
        parameters=known.parameters[TURNED], centre=known.centre[TURNED], noise=known.noise[TURNED],
        coverage=Coverage(*(part[TURNED] for part in known.coverage)),
    )  # fmt: skip
    return swapped, known


def healthy_runs():
    """Two runs in which nothing steps."""
    runs = [train(1), train(2)]
    for run in runs:
        run.temperature[K // 2 :, 1, 1] -= 6.0
    return runs


@pytest.fixture(scope="module")
def known():
    return method.learn(FLEET, healthy_runs())


def through(monitor, record, work=MOTORS):
    """All samples of a record; so many motors are judged after each."""
    ones = np.ones(record.motors)
    for k in range(len(record.at)):
        monitor.add_sample(
            record.temperature[k], record.current_square[k], ones * record.speed[k],
            ones * record.ambient[k],
        )  # fmt: skip
        monitor.judge(work)
    return monitor


def same(one, other, turned=None):
    ours = one.motors if turned is None else one.motors[turned]
    assert repr(ours.tolist()) == repr(other.motors.tolist())


def test_turned_motors_turn_what_is_said(known):
    record = train(3)
    swapped, other = turn(record, known)
    one, two = ThermalMonitor(known, 1.0), ThermalMonitor(other, 1.0)
    # A mean over motors rounds by their order.
    np.testing.assert_allclose(one.config["settles_k"], two.config["settles_k"], rtol=1e-12)
    two.config["settles_k"] = one.config["settles_k"]
    same(through(one, record), through(two, swapped), TURNED)
    kind, size = one.kinds()
    np.testing.assert_array_equal(kind[TURNED], two.kinds()[0])
    np.testing.assert_array_equal(size[TURNED], two.kinds()[1])
    assert kind[1].sum() > 0.5 > np.delete(kind, 1, axis=0).sum(axis=1).max()


def test_later_samples_change_nothing(known):
    record, cut = train(4), 1777
    wild = record._replace(
        temperature=record.temperature.copy(), current_square=record.current_square.copy()
    )
    wild.temperature[cut:] = 500.0
    wild.current_square[cut:] = np.nan
    watching = method.Watching(known)
    kinds, sizes, sides = watching.believe(record)
    for kind, size, side in (watching.believe(wild), watching.believe(_first(record, cut))):
        np.testing.assert_array_equal(kind[:cut], kinds[:cut])
        np.testing.assert_array_equal(size[:cut], sizes[:cut])
        np.testing.assert_array_equal(side[:cut], sides[:cut])


def _first(record, k):
    return Record(*(field[:k] for field in record[:5]), record.step_s)


@pytest.mark.parametrize("pace", [0, 1, 3])
def test_who_judges_slowly_judges_alike(known, pace):
    """Those that wait are judged at the latest when the next block is there: nothing is lost."""
    record = train(5)
    monitor = through(ThermalMonitor(known, 1.0), record, pace)
    monitor.judge(MOTORS)
    same(through(ThermalMonitor(known, 1.0), record), monitor)


def test_nothing_grows(known):
    monitor = through(ThermalMonitor(known, 1.0), _first(train(6), 300))

    def sizes():
        return {n: a.nbytes for n, a in vars(monitor).items() if isinstance(a, np.ndarray)}

    before, names = sizes(), set(vars(monitor))
    through(monitor, train(6))
    assert sizes() == before
    assert set(vars(monitor)) == names
    assert sum(before.values()) < 30_000 * MOTORS


def test_inputs_between_samples_are_averaged(known):
    fine = train(7, k=1200, step_s=0.5, every=2)
    mean = Record(
        fine.temperature, np.arange(1200), fine.current_square.reshape(-1, 2, MOTORS).mean(axis=1),
        fine.speed.reshape(-1, 2).mean(axis=1), fine.ambient.reshape(-1, 2).mean(axis=1), 1.0,
    )  # fmt: skip
    one, two = ThermalMonitor(known, 1.0), ThermalMonitor(known, 1.0)
    judged = sum(method.followed(one, fine))
    assert judged == 1200 // one.block
    assert sum(method.followed(two, mean)) == judged
    for ours, theirs in (
        (one.motors["lumps"], two.motors["lumps"]),
        *((one.motors["imm"][name], two.motors["imm"][name]) for name in ("mean", "mode")),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("dt_s", [0.5, 1.0, 5.0])
def test_absurd_samples_raise_nothing_and_leave_numbers(known, dt_s):
    rng = np.random.default_rng(8)
    monitor = ThermalMonitor(known, dt_s)
    for k in range(3000):
        wild = 10.0 ** rng.uniform(0.0, 6.0) if k % 5 == 0 else 30.0
        reading = 50.0 + wild * rng.standard_normal((MOTORS, 3))
        inputs = rng.uniform(0.0, 1.0, (3, MOTORS)) * np.array([[4e5], [1e3], [100.0]])
        reading[rng.random((MOTORS, 3)) < 0.1] = np.nan
        inputs[rng.random((3, MOTORS)) < (0.9 if k // 300 % 3 == 1 else 0.02)] = np.nan
        monitor.add_sample(reading, *inputs)
        monitor.judge(int(rng.integers(0, 3)))
        kind, size = monitor.kinds()
        assert kind.min() >= 0.0
        assert kind.sum(axis=1).max() <= 1.0
        assert np.isfinite(size).all(), k
    filters = monitor.motors["imm"]
    parts = [filters[name] for name in ("mode", "mean", "cov")]
    parts += [monitor.motors[name] for name in ("base_k", "loose", "lumps")]
    assert all(np.isfinite(part).all() for part in parts)
    np.testing.assert_allclose(filters["mode"].sum(axis=1), 1.0)


def test_samples_too_close_together_are_refused(known):
    with pytest.raises(ValueError, match="too close together"):
        ThermalMonitor(known, 0.1)


def test_what_is_learnt_is_right_and_knows_no_order(known):
    runs = healthy_runs()
    assert np.abs(known.noise / NOISE_K - 1.0).max() < 0.2
    swapped = [turn(run, known)[0] for run in runs]
    got, want = method.learn(FLEET[TURNED], swapped), turn(runs[0], known)[1]
    assert isinstance(got, Known)
    assert got.scale == want.scale
    for name in ("parameters", "centre", "noise", "duty"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.coverage.lag_one, want.coverage.lag_one, rtol=1e-6)
    square, speed = (np.mean([x.mean() for x in c]) for c in
                     ([r.current_square for r in runs], [r.speed for r in runs]))  # fmt: skip
    np.testing.assert_allclose(got.duty[:2], [speed, square])


def test_a_model_that_explains_less_is_trusted_less(known):
    """What five lumps have no number for, here the sun on one motor, widens what is learnt."""
    runs, rng = healthy_runs(), np.random.default_rng(8)
    for run in runs:
        run.temperature[:, 2] += 0.15 * np.cumsum(rng.standard_normal(K) / 8.0)[:, None]
    wrong = method.learn(FLEET, runs)
    assert wrong.own_k > known.own_k
    config = ThermalMonitor(wrong, 1.0).config["imm"]
    assert config["own_k"] == wrong.own_k
    assert config["ambiguous"] == (AMBIGUOUS if wrong.own_k > MISFIT_K else 0.0)
    assert ThermalMonitor(known, 1.0).config["imm"]["ambiguous"] == 0.0
