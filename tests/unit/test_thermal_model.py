"""The product's thermal method: model, identification, hypotheses; and how it is judged."""

import numpy as np
import pytest

from estimators.thermal import hypotheses, model
from estimators.thermal.hypotheses import APART_HIDDEN_K, KINDS, SIZES_K, side, side_apart
from estimators.thermal.model import TYPICAL, Inputs, inputs_of, predict, steady_state
from estimators.thermal.model_method import ModelMethod
from estimators.thermal.record import Record, fading, features, join, split
from estimators.thermal.system_identification import first_readings, identify
from tests import thermal_core

MOTORS = 4


def steady_drive(hours=200.0, square=1e4, speed=150.0, ambient=12.0):
    steps = round(hours * 60)
    return Inputs(
        np.full((steps, MOTORS), square), np.full(steps, speed), np.full(steps, ambient),
        np.arange(59, steps, 60), 60.0,
    )  # fmt: skip


def record(seed, k=300, noise=0.3, spread=0.1):
    """Motors that are the model itself, with readings of them."""
    own = np.random.default_rng(99)
    parameters = TYPICAL * np.exp(spread * own.normal(size=(MOTORS, model.COUNT)))
    parameters[:, model.OFFSETS] = own.normal(0.0, 0.5, (MOTORS, 3))
    rng = np.random.default_rng(seed)
    steps = 60 * k
    square = np.repeat(rng.uniform(0.0, 4e4, steps // 30), 30)[:, None] * np.ones(MOTORS)
    speed = np.repeat(rng.uniform(0.0, 400.0, steps // 60), 60)
    ambient = 15.0 + 8.0 * np.sin(np.arange(steps) / 1440.0)
    at = np.arange(60, steps + 1, 60) - 1
    inputs = Inputs(square, speed, ambient, at, 60.0)
    truth = predict(parameters, inputs)
    reading = truth + noise * rng.standard_normal(truth.shape)
    return Record(reading, at, square, speed, ambient, 60.0), truth


def test_the_model_settles_where_algebra_says():
    inputs = steady_drive()
    flat = TYPICAL.copy()
    got = predict(np.tile(flat, (MOTORS, 1)), inputs)[-1, 0]
    base = steady_state(flat, 1e4, 150.0, 12.0, np.zeros(model.EXTRA))
    # The winding's resistance rises with its temperature, which the start leaves out.
    assert got[0] == pytest.approx(base[0], rel=0.05)
    copper = flat[model.A] * 1e4 * (1.0 + 0.0039 * (got[0] - 60.0))
    core = got[0] - copper / flat[model.K_W]
    iron = flat[model.E_1] * 150.0 + flat[model.E_2] * 150.0**2
    through = flat[model.K_C] * (got[0] - core) + iron
    frame = core - through / flat[model.G_C]
    end = (flat[model.K_D] * frame + flat[model.F_D] * 150.0 + flat[model.B_D] * 12.0) / (
        flat[model.K_D] + flat[model.B_D]
    )
    assert got[1] == pytest.approx(end, abs=0.01)


def test_deviations_follow_the_system_matrix():
    """A little warmer lump fades in the model as the matrix of deviations says."""
    flat = TYPICAL.copy()
    matrix = model.system_matrix(flat, 1e4, 150.0)
    for lump in range(model.LUMPS):
        base, warmer = np.full(model.LUMPS, 60.0), np.full(model.LUMPS, 60.0)
        warmer[lump] += 1.0
        for x in (base, warmer):
            thermal_core.step(flat, 1e4, 150.0, 12.0, np.zeros(model.EXTRA), 1e-3, x)
        got = (warmer - base - np.eye(model.LUMPS)[lump]) / 1e-3
        np.testing.assert_allclose(got, matrix[:, lump], rtol=1e-4, atol=1e-7)


def test_long_steps_are_stable():
    inputs = steady_drive()._replace(step_s=36_000.0)
    assert np.isfinite(predict(np.tile(TYPICAL, (MOTORS, 1)), inputs)).all()
    assert predict(np.tile(TYPICAL, (MOTORS, 1)), inputs).max() < 200.0


def test_identified_motors_predict_another_run():
    seen, _ = record(1)
    other, truth = record(2)
    found = identify([seen])
    error = predict(found, inputs_of(other), first_readings(other)) - truth
    assert np.sqrt(np.mean(error[5:] ** 2)) < 0.25
    turned = [2, 0, 3, 1]
    swapped = seen._replace(
        temperature=seen.temperature[:, turned], current_square=seen.current_square[:, turned]
    )
    np.testing.assert_allclose(identify([swapped]), found[turned], rtol=1e-6, atol=1e-9)


def test_identification_bears_holes_and_refuses_nothing_at_all():
    seen, truth = record(3)
    holes = seen.temperature.copy()
    holes[::3, 1, 2] = np.nan
    found = identify([seen._replace(temperature=holes)])
    error = predict(found, inputs_of(seen), first_readings(seen)) - truth
    assert np.sqrt(np.mean(error[5:] ** 2)) < 0.3
    with pytest.raises(ValueError, match="all temperatures"):
        identify([seen._replace(temperature=np.full_like(holes, np.nan))])


def shapes(k):
    """Of heat: a resistance goes with the current, a bearing with the speed."""
    rows = [(1.0, 0.35, 0.35), (1.0, 0.8, 0.8), (0.1, 1.0, 0.1), (0.1, 0.1, 1.0)]
    wave = 1.0 + 0.9 * np.sin(np.arange(k) / 3.0)
    out = np.tile(np.array([*rows, rows[0]]), (k, 1, 1))
    out[:, 4] *= wave[:, None]
    out[:, 2:4] *= (1.0 + 0.5 * np.cos(np.arange(k) / 4.0))[:, None, None]
    return out


def believe(z, known, signatures):
    return hypotheses.believe(z, known, signatures)


def healthy_beside(k=360, seed=0):
    """Residuals that share a slow part between a motor's points."""
    rng = np.random.default_rng(seed)
    common = np.zeros((k, MOTORS, 1))
    for n in range(1, k):
        common[n] = 0.9 * common[n - 1] + 0.35 * rng.standard_normal((MOTORS, 1))
    return common * np.array([1.0, 0.9, 0.9]) + 0.3 * rng.standard_normal((k, MOTORS, 3))


@pytest.fixture(scope="module")
def known():
    return hypotheses.spread(healthy_beside(2000, 7), 40.0)


def test_whitened_health_is_white(known):
    z = hypotheses.beside_peers(healthy_beside(2000, 8) - known.centre, 40.0)
    for m in range(MOTORS):
        parts = z[:, m] @ known.white[m].T
        np.testing.assert_allclose(np.cov(parts.T), np.eye(3), atol=0.45)
    assert known.share.min() < 0.2 < 0.7 < known.share.max(), "slow in common, quick of its own"


def test_nothing_wrong_is_nothing_said(known):
    said = [believe(healthy_beside(seed=s), known, shapes(360)).fault.max() for s in range(5)]
    assert np.median(said) < 0.5


@pytest.mark.parametrize("kind", KINDS[:8])
@pytest.mark.parametrize("size", [5.0, 8.0])
def test_every_kind_is_told_from_every_other(known, kind, size):
    z = healthy_beside(seed=3)
    index = KINDS.index(kind)
    if index < 5:
        z[180:270, 2] += size * shapes(360)[180:270, index]
    else:
        z[180:270, 2, index - 5] -= size
    belief = believe(z, known, shapes(360))
    assert belief.fault[:180, 2].mean() < 0.05
    assert (belief.fault[200:270, 2] > 0.5).mean() > 0.9
    others = np.delete(belief.fault, 2, axis=1)
    assert others[180:].mean() < 0.05
    told = belief.kind[200:270, 2].mean(axis=0)
    assert KINDS[int(told.argmax())] == kind
    sizes = belief.size_k[230:270, 2].mean()
    assert sizes == pytest.approx(size, rel=0.45)
    assert SIZES_K.max() > size


def test_heat_or_sensor_is_named_only_when_sure():
    """One row a case: heat, sensors off, loose connectors."""
    rows = [
        ([0.5, 0.4], [0.0, 0.0], 0.0, 1), ([0.9, 0.0], [0.05, 0.0], 0.02, 0),
        ([0.003, 0.003], [0.9, 0.0], 0.05, -1), ([0.4, 0.0], [0.4, 0.0], 0.2, 0),
        ([0.3, 0.0], [0.1, 0.0], 0.6, -1), ([0.9, 0.0], [0.004, 0.004], 0.09, 1),
    ]  # fmt: skip
    kind = np.zeros((len(rows), len(KINDS)))
    for row, (hot, off, loose, _) in zip(kind, rows, strict=True):
        row[1:3], row[5:7], row[9] = hot, off, loose
    assert side(kind).tolist() == [row[-1] for row in rows]
    assert int(side(kind[0])) == 1
    for share in (0.9899, 0.9901):
        row = np.zeros(len(KINDS))
        row[3], row[7] = 0.8 * share, 0.8 * (1.0 - share)
        assert int(side(row)) == (share > 0.99)


def _apart(rows):
    """`side_apart` of samples of one motor, each of kinds' probabilities and a sensor's error."""
    kind = np.zeros((len(rows), 1, len(KINDS)))
    for k, (said, _) in enumerate(rows):
        for name, p in said.items():
            kind[k, 0, KINDS.index(name)] = p
    rise = np.array([[rise_k] for _, rise_k in rows])
    return side_apart(kind, rise, shapes(len(rows)))[:, 0].tolist()


def test_hours_apart_a_side_has_to_last_and_to_be_surer():
    hot, off = {"bearing_de": 0.9}, {"bias_de": 0.9}
    assert _apart([(hot, 0.0)] * 5) == [0, 0, 1, 1, 1]
    assert _apart([(hot, 0.0), (hot, 0.0), (off, -6.0), (hot, 0.0), (hot, 0.0)]) == [0] * 5
    assert _apart([({"bearing_de": 0.9, "bias_de": 0.002}, 0.0)] * 4) == [0] * 4
    assert _apart([({"loose_de": 0.9}, 0.0)] * 4) == [0, 0, -1, -1]
    assert _apart([({"loose_de": 0.6, "overheating": 0.3}, 0.0)] * 4) == [0] * 4, "a likely burst"
    air, end = ({"cooling_loss": 0.9}, 0.0), ({"bearing_de": 0.99}, 0.0)
    assert _apart([air, air, air, end, air, end, end]) == [0, 0, 1, 0, 0, 0, 1], "a burst, twice"


@pytest.mark.parametrize("sensor", ["bias_stator", "bias_de", "bias_nde"])
def test_hours_apart_a_sensor_reads_high_only_where_heat_would_have_shown_elsewhere(sensor):
    said = {sensor: 0.9}
    hot = {"bias_stator": "overheating", "bias_de": "bearing_de", "bias_nde": "bearing_nde"}
    point = list(hot).index(sensor)
    shape = shapes(3)[-1, KINDS.index(hot[sensor])]
    least = APART_HIDDEN_K / np.delete(shape, point).max()
    assert _apart([(said, 1.01 * least)] * 3)[-1] == -1
    assert _apart([(said, 0.99 * least)] * 3)[-1] == 0
    assert _apart([(said, -2.0)] * 3)[-1] == -1, "heat does not cool"


def test_a_loose_connector_is_told(known):
    z = healthy_beside(seed=4)
    rng = np.random.default_rng(1)
    bursts = 180 + np.flatnonzero(rng.random(90) < 0.1)
    z[bursts, 1, 0] += 25.0
    belief = believe(z, known, shapes(360))
    assert belief.kind[bursts[3] : 260, 1, KINDS.index("loose_stator")].mean() > 0.7
    assert belief.fault[:180].mean() < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_wear_between_the_bursts_of_a_loose_connector_is_learnt(known, seed):
    """Else it passes for lost cooling once the connector is forgotten."""
    z = healthy_beside(seed=20 + seed)
    wear = np.clip((np.arange(360) - 110) / 160.0, 0.0, 1.0)
    z[:, 1] += 6.0 * wear[:, None] * shapes(360)[:, KINDS.index("cooling_loss")]
    plain = believe(z, known, shapes(360))
    rng = np.random.default_rng(seed)
    z[100 + np.flatnonzero(rng.random(200) < 0.06), 1, 1] += 30.0
    belief = believe(z, known, shapes(360))
    hot = (belief.side[100:, 1] > 0).mean()
    assert hot <= (plain.side[100:, 1] > 0).mean() + 0.01
    assert belief.kind[120:300, 1, KINDS.index("loose_de")].max() > 0.9


def test_missing_points_say_nothing_and_break_nothing(known):
    z = healthy_beside(seed=5)
    z[180:270, 0] += 8.0 * shapes(360)[180:270, 0]
    holes = z.copy()
    holes[100:300, 0, 2] = np.nan
    holes[50:60] = np.nan
    belief = believe(holes, known, shapes(360))
    assert np.isfinite(belief.kind).all()
    assert belief.fault[210:270, 0].mean() > 0.9
    assert belief.fault[:180].mean() < 0.1


def test_permuted_motors_permute_and_later_samples_change_nothing(known):
    z = healthy_beside(seed=6)
    z[180:270, 3, 1] += 6.0
    all_of_it = believe(z, known, shapes(360))
    np.testing.assert_array_equal(
        believe(z[:200], known, shapes(360)[:200]).kind, all_of_it.kind[:200]
    )
    turned = [3, 1, 0, 2]
    swapped = hypotheses.Spread(*(a[turned] for a in known))
    np.testing.assert_array_equal(
        believe(z[:, turned], swapped, shapes(360)).kind, all_of_it.kind[:, turned]
    )


def beside(u, trusted=None):
    everybody = np.ones(len(u), dtype=np.bool_)
    return hypotheses.peers_median(u, everybody if trusted is None else trusted)


def test_the_peers_median_is_pulled_by_no_fault_and_by_no_suspect():
    rng = np.random.default_rng(0)
    for motors in (4, 5, 7, 16):
        u = rng.normal(size=(motors, 3))
        u[1, 2] = np.nan
        want = [np.nanmedian(np.delete(u, m, axis=0), axis=0) for m in range(motors)]
        np.testing.assert_allclose(beside(u), want)
    u = np.zeros((4, 3))
    u[1], u[2], u[3] = 10.0, 1.0, 2.0
    np.testing.assert_array_equal(beside(u)[0], 2.0)
    trusted = np.array([True, False, True, True])
    np.testing.assert_array_equal(beside(u, trusted)[0], 1.5)
    np.testing.assert_array_equal(beside(u, trusted)[1], 1.0)
    np.testing.assert_array_equal(beside(u, np.zeros(4, dtype=np.bool_)), beside(u))
    np.testing.assert_array_equal(beside(u[1:], trusted[1:])[1:], [[2.0] * 3, [1.0] * 3])
    u[[0, 3]] = np.nan
    assert np.isnan(beside(u)[1:3]).all(), "one other motor is nobody to compare with"
    np.testing.assert_array_equal(beside(u)[0], 5.5)
    np.testing.assert_array_equal(beside(np.array([[3.0, 4.0, 5.0]])), 0.0)


def test_of_three_motors_the_ill_one_does_not_make_the_others_ill():
    """The mean of two is half of what is wrong with one of them."""
    u = np.repeat([[6.0], [6.5], [40.0]], 3, axis=1)
    for sign in (1.0, -1.0):
        np.testing.assert_array_equal(beside(sign * u)[0], sign * 6.5)
        np.testing.assert_array_equal(beside(sign * u)[1], sign * 6.0)
        np.testing.assert_array_equal(beside(sign * u)[2], sign * 6.25)
    u[2] = 8.5
    np.testing.assert_array_equal(beside(u)[0], 7.5, "what weather may do is taken out")


def test_a_fault_leaves_the_baselines_of_the_others_alone(known):
    """Motors that have aged apart: a median over raw residuals would step when one falls ill."""
    z = healthy_beside(seed=3)
    z += np.linspace(0.0, 1.0, 360)[:, None, None] * np.array([-3.0, 0.0, 3.0, 1.0])[:, None]
    z[180:270, 3, 0] += 8.0
    belief = believe(z, known, shapes(360))
    assert belief.fault[190:268, 3].mean() > 0.9
    assert belief.fault[:, :3].mean() < 0.03
    assert belief.fault[280:, 3].mean() < 0.1


def test_records_can_be_split_and_joined():
    whole, _ = record(4, k=20)
    first, rest = split(whole, 13)
    assert len(first.at) == 13
    assert len(rest.speed) == 7 * 60
    again = join([first, rest])
    for mine, theirs in zip(again, whole, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with pytest.raises(ValueError, match="one step length"):
        join([first, rest._replace(step_s=1.0)])
    assert features(whole).shape == (20, 5)
    np.testing.assert_allclose(fading(np.full(50, 3.0), 0.1), 3.0)


def test_the_method_end_to_end_on_the_models_own_train():
    healthy, _ = record(5, k=400)
    test, _ = record(6)
    ill = test.temperature.copy()
    ill[150:200, 2, 1] += 5.0
    fitted = ModelMethod().fit(healthy)
    statistic = fitted(test._replace(temperature=ill))
    assert np.mean(statistic[155:200] > 0.0) > 0.9
    assert np.mean(statistic[:150] > 0.0) < 0.05
    belief = fitted.believe(test._replace(temperature=ill))
    assert KINDS[int(belief.kind[160:200, 2].mean(axis=0).argmax())] == "bias_de"
