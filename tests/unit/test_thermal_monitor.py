"""The thermal monitor by law, on trains that are the model itself and noise."""

import numpy as np
import pytest

from estimators.thermal import model
from estimators.thermal import model_method as method
from estimators.thermal.hypotheses import HEAT, KINDS, side
from estimators.thermal.monitor import GAP_S, MISFIT_K, ThermalMonitor, followed
from estimators.thermal.record import Record
from tests.thermal_core import SIZE, start, step

MOTORS, ILL, NOISE_K, HOUR = 4, 2, 0.25, 3600
TURNED = [2, 0, 3, 1]
SEEN = list(model.MEASURED)


def fleet():
    rng = np.random.default_rng(99)
    out = model.TYPICAL * np.exp(0.1 * rng.standard_normal((MOTORS, model.COUNT)))
    out[:, model.OFFSETS] = rng.normal(0.0, 0.5, (MOTORS, 3))
    return out


FLEET = fleet()


def duty(seed, k):
    """Another power and speed every five minutes: A^2 (K, M), rad/s, degC of the air."""
    rng = np.random.default_rng(seed)
    square = np.repeat(rng.uniform(0.0, 4e4, k // 300 + 1), 300)[:k]
    speed = np.repeat(rng.uniform(50.0, 350.0, k // 300 + 1), 300)[:k]
    air = 15.0 + 3.0 * np.sin(np.arange(k) / 3000.0)
    return np.outer(square, 1.0 + 0.01 * np.arange(MOTORS)), speed, air


def made(kind, size_k, square, speed):
    """Parameters and extra heat of a train whose motor ILL will be about `size_k` warmer by it."""
    p, extra = FLEET.copy(), np.zeros((MOTORS, model.EXTRA))
    square, speed = square[:, ILL].mean(), speed.mean()
    seen = (-np.linalg.inv(model.system_matrix(FLEET[ILL], square, speed)))[SEEN].max(axis=0)
    w, _, f, _, _ = model.steady_state(FLEET[ILL], square, speed, 0.0, np.zeros(model.EXTRA))
    if kind == "overheating":
        extra[ILL, model.WINDING] = size_k / seen[model.WINDING]
    elif kind == "cooling_loss":
        p[ILL, [model.H_0, model.H_1]] *= f / (f + size_k)
    elif kind == "bearing_de":
        p[ILL, model.F_D] += size_k / seen[model.DRIVE_END] / speed
    elif kind == "bearing_nde":
        p[ILL, model.F_N] += size_k / seen[model.OTHER_END] / speed
    elif kind == "winding_resistance":
        warm = 1.0 + 0.0039 * (15.0 + w - 60.0)
        p[ILL, model.A] += size_k / seen[model.WINDING] / square / warm
    return p, extra


def train(
    seed, k=2 * HOUR, kind=None, size_k=8.0, onset=HOUR // 2, error=None, air=None, cold=False,
    parked=slice(0),
):  # fmt: skip
    """A record at 1 Hz; error (K, M, 3) K of its sensors; air (K,) degC that nobody measures."""
    square, speed, ambient = duty(seed, k)
    square[parked], speed[parked] = 0.0, 0.0
    real = ambient if air is None else air
    none = np.zeros((MOTORS, model.EXTRA))
    state = np.full((MOTORS, model.LUMPS), ambient[0])
    if not cold:
        mean, air_0 = (square[:600].mean(axis=0), speed[:600].mean()), ambient[0]
        state = np.stack([
            model.steady_state(p, mean[0][m], mean[1], air_0, none[m]) for m, p in enumerate(FLEET)
        ])  # fmt: skip
    lumps = np.empty((k, MOTORS, model.LUMPS))
    for part, p, extra in (
        (slice(onset), FLEET, none), (slice(onset, None), *made(kind, size_k, square, speed))
    ):  # fmt: skip
        at = np.arange(len(speed[part]))
        inputs = model.Inputs(square[part], speed[part], real[part], at, 1.0)
        lumps[part] = model.run(p, inputs, extra, state)
    noise = NOISE_K * np.random.default_rng([seed, 1]).standard_normal((k, MOTORS, 3))
    reading = lumps[:, :, SEEN] + FLEET[:, model.OFFSETS] + noise
    return Record(
        reading + (0.0 if error is None else error), np.arange(k), square, speed, ambient, 1.0
    )


def mean_of(monitor):
    """(M, 9, 12): of the filters."""
    return monitor.motors["imm"]["mean"]


def watched(known, record, hole=None, work=MOTORS):
    """The monitor, and after each sample whether motors are held (K, M) and kinds (K, M, 11).

    hole: (first, end, motors) without inputs.
    """
    monitor, ones = ThermalMonitor(known, record.step_s), np.ones(record.motors)
    held, kind = [], []
    for k in range(len(record.at)):
        square = record.current_square[k].copy()
        if hole is not None and hole[0] <= k < hole[1]:
            square[hole[2]] = np.nan
        monitor.add_sample(
            record.temperature[k], square, ones * record.speed[k], ones * record.ambient[k]
        )
        monitor.judge(work)
        held.append(monitor.held)
        # Twice in a block: it is here for what it says, not for how fast.
        kind.append(monitor.kinds()[0] if k % 8 == 0 else kind[-1])
    return monitor, np.array(held), np.array(kind)


@pytest.fixture(scope="module")
def known():
    return method.learn(FLEET, [train(11), train(12)])


def found(known, record, kind, within_s, onset=HOUR // 2):
    """Only the ill motor is suspected, within that time, and rightly called at the end."""
    _, held, kinds = watched(known, record)
    told = kinds.sum(axis=2) > 0.5
    assert not told[:onset].any()
    assert not np.delete(told, ILL, axis=1).any()
    assert not np.delete(held, ILL, axis=1).any()
    assert told[onset + within_s :, ILL].mean() > 0.95
    assert KINDS[int(kinds[-HOUR // 2 :, ILL].mean(axis=0).argmax())] == kind


@pytest.mark.parametrize("kind", KINDS[:5])
def test_every_kind_of_heat_is_found_and_named(known, kind):
    found(known, train(31, kind=kind), kind, 900 if kind == "cooling_loss" else 300)


@pytest.mark.parametrize("kind", KINDS[5:])
def test_every_ill_sensor_is_found_and_named(known, kind):
    error = np.zeros((2 * HOUR, MOTORS, 3))
    point, loose = (KINDS.index(kind) - 5) % 3, kind.startswith("loose")
    if loose:
        for first in np.flatnonzero(np.random.default_rng(5).random(3 * HOUR // 2) < 0.01):
            error[HOUR // 2 + first :, ILL, point][:5] = 25.0
    else:
        error[HOUR // 2 :, ILL, point] = 6.0 - 12.0 * (point == 1)
    found(known, train(32, error=error), kind, 900 if loose else 60)


@pytest.mark.parametrize("point", range(3))
def test_a_creeping_sensor_is_found(known, point):
    """Slower than any step; up it may be called what warms there, but is not forgotten."""
    error = np.zeros((2 * HOUR, MOTORS, 3))
    error[HOUR // 2 :, ILL, point] = np.minimum(np.arange(3 * HOUR // 2) * 0.02, 6.0)
    monitor, held, _ = watched(known, train(33, error=error))
    assert abs(mean_of(monitor)[ILL, 1 + len(HEAT) + point, SIZE] - 6.0) < 1.0
    assert held[HOUR:, ILL].mean() > 0.95
    assert not held[: HOUR // 2].any()
    assert not np.delete(held, ILL, axis=1).any()


@pytest.mark.parametrize("point", range(3))
def test_nothing_cools_a_motor_but_a_sensor(known, point):
    error = np.zeros((2 * HOUR, MOTORS, 3))
    error[HOUR // 2 :, ILL, point] = -np.minimum(np.arange(3 * HOUR // 2) * 0.02, 6.0)
    found(known, train(34, error=error), KINDS[5 + point], 900)


@pytest.mark.parametrize(("motors", "named"), [(3, 0), (4, -1)])
def test_where_models_fit_less_a_sensor_that_reads_low_is_named_beside_three_motors(
    known, motors, named
):
    """Beside two, one of them may be hot instead: that moves the median of both."""
    error = np.zeros((2 * HOUR, MOTORS, 3))
    error[HOUR // 2 :, ILL, 1] = -np.minimum(np.arange(3 * HOUR // 2) * 0.01, 8.0)
    record, kept = train(36, error=error), slice(motors)
    part = record._replace(
        temperature=record.temperature[:, kept], current_square=record.current_square[:, kept]
    )
    fleet = known._replace(
        parameters=known.parameters[kept], centre=known.centre[kept], noise=known.noise[kept],
        own_k=2.0 * MISFIT_K, coverage=None,
    )  # fmt: skip
    _, held, kinds = watched(fleet, part, work=motors)
    assert held[-HOUR // 4 :, ILL].all()
    assert set(side(kinds[-HOUR // 4 :, ILL]).tolist()) == {named}


@pytest.mark.parametrize("point", range(3))
def test_a_sensor_that_crept_and_is_changed_is_well_again(known, point):
    """What steps back to where it was has no step."""
    error = np.zeros((2 * HOUR, MOTORS, 3))
    crept = slice(HOUR // 2, 5 * HOUR // 4)
    error[crept, ILL, point] = -np.minimum(np.arange(3 * HOUR // 4) * 0.01, 6.0)
    monitor, held, _ = watched(known, train(35, error=error))
    assert held[HOUR : 5 * HOUR // 4, ILL].mean() > 0.9
    assert not held[-HOUR // 4 :].any()
    assert not monitor.offsets.any()


@pytest.mark.parametrize("seed", range(2))
def test_hours_of_health_are_silent(known, seed):
    _, held, _ = watched(known, train(40 + seed, 3 * HOUR))
    assert not held.any()


def test_cold_motors_weather_and_tunnels_are_no_faults(known):
    tunnel = 15.0 + 15.0 * (np.arange(2 * HOUR) // 900 % 2)
    for record in (train(51, cold=True), train(52, air=tunnel)):
        assert not watched(known, record)[1].any()
    outside = train(53)
    outside = outside._replace(ambient=outside.ambient + tunnel - 15.0)
    assert not watched(known, outside)[1].any(), "a sensor of the air in the sun"


@pytest.mark.parametrize("length", [15, 45, 90, 900])
@pytest.mark.parametrize("motors", [[1], list(range(MOTORS))])
def test_holes_in_the_inputs_are_no_faults(known, length, motors):
    """Short ones the model bridges, after long ones the motor begins anew; with duty changing."""
    record = train(63, HOUR)
    monitor, held, kinds = watched(known, record, (1800, 1800 + length, motors))
    assert not held.any()
    assert kinds[:, :, 5:8].max() < 0.5
    blocks = (len(record.at) - (1800 + length if length > GAP_S else 0)) // monitor.block
    assert abs(monitor.motors["judged"][1] - blocks) <= 1
    assert np.isfinite(mean_of(monitor)).all()


@pytest.mark.parametrize("seed", [61, 62])
def test_one_motor_that_begins_anew_beside_others_is_not_suspected(known, seed):
    assert not watched(known, train(seed, HOUR), (1800, 1890, [1]))[1].any()


@pytest.mark.parametrize("warmer_k", [-15.0, 15.0, 30.0])
def test_in_weather_that_nobody_measures_a_motor_begins_anew_beside_the_others(known, warmer_k):
    """All motors differ from their models by it, and this one does again from its first sample."""
    record = train(64, HOUR, air=duty(64, HOUR)[2] + warmer_k)
    record.current_square[1800:1890, 1] = np.nan
    monitor = ThermalMonitor(known, 1.0)
    off = [monitor.motors["off_k"][1].copy() for _ in followed(monitor, record)]
    assert np.isnan(off[1889]).all()
    assert np.nanmax(np.abs(off[1890:])) < 5.0 < 0.5 * np.abs(monitor.motors["peers_k"]).min()


@pytest.mark.parametrize("goes_on", [3 * HOUR // 2, 2 * HOUR])
def test_after_ten_minutes_a_parked_motor_is_what_it_was_when_it_stopped(known, goes_on):
    """One that cools more slowly, by 3 K, has no fault, then and after it has gone on; a hot one
    stays hot for as long as it is warmer."""
    stops, slower = 2 * HOUR // 3, np.zeros((2 * HOUR, MOTORS, 3))
    since = np.clip((np.arange(2 * HOUR) - stops) / 4000.0, 0.0, 1.0)
    slower[:, ILL] = 3.0 * np.sin(np.pi * since)[:, None]
    record = train(92, error=slower, parked=slice(stops, goes_on))
    assert not watched(known, record)[1][stops + 660 :].any()
    hot = train(92, kind="cooling_loss", size_k=15.0, parked=slice(stops, goes_on))
    _, held, _ = watched(known, hot)
    assert held[stops : stops + 600, ILL].all()
    assert not np.delete(held, ILL, axis=1).any()


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("point", range(3))
def test_a_point_without_a_sensor_hides_no_heat_elsewhere(known, everywhere, point):
    record = train(71, HOUR + 900, "overheating" if point else "bearing_de")
    record.temperature[:, slice(None) if everywhere else ILL, point] = np.nan
    _, held, _ = watched(known, record)
    assert held[-HOUR // 4 :, ILL].all()
    assert not np.delete(held, ILL, axis=1).any()
    assert not held[: HOUR // 2].any()


def test_one_motor_is_judged_as_beside_motors_that_are_the_model(known):
    """Whose peers read what the model says differs from them by what it differs from the model."""
    record = train(81, HOUR, "bearing_de")
    alike = known._replace(
        parameters=np.tile(FLEET[ILL], (MOTORS, 1)), centre=0.0 * known.centre,
        noise=np.full((MOTORS, 3), NOISE_K), coverage=None,
    )  # fmt: skip
    reading, x = record.temperature.copy(), np.empty(model.LUMPS)
    first = np.array([70.0, 45.0, 45.0])
    start(FLEET[ILL], first, record.speed[0], record.ambient[0], x)
    for k in range(HOUR):
        step(FLEET[ILL], record.current_square[k, ILL], record.speed[k], record.ambient[k],
             np.zeros(5), 1.0, x)  # fmt: skip
        reading[k] = x[SEEN] + FLEET[ILL, model.OFFSETS]
        if k == 0:
            reading[0] = first
    reading[:, ILL] = record.temperature[:, ILL]
    square = np.tile(record.current_square[:, [ILL]], MOTORS)
    many, _, kinds = watched(alike, record._replace(temperature=reading, current_square=square))
    one = alike._replace(parameters=FLEET[[ILL]], centre=alike.centre[:1], noise=alike.noise[:1])
    own = record._replace(temperature=reading[:, [ILL]], current_square=square[:, [ILL]])
    single, held, own_kinds = watched(one, own)
    np.testing.assert_allclose(own_kinds[:, 0], kinds[:, ILL], atol=1e-6)
    np.testing.assert_allclose(mean_of(single)[0], mean_of(many)[ILL], rtol=1e-5, atol=1e-6)
    assert held[-600:].all()


def test_without_peers_nothing_is_said(known):
    record = train(82, HOUR, "overheating")
    record.temperature[:, np.arange(MOTORS) != ILL] = np.nan
    monitor, held, _ = watched(known, record)
    assert not held.any()
    assert np.isnan(monitor.motors["off_k"]).all()
