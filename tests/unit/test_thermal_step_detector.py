"""Steps of sensors: found within half a minute; nothing else is taken for one, no quick heat."""

import numpy as np
import pytest

from dbc.codec import bind
from estimators.thermal import model, step_detector
from estimators.thermal.monitor import Known, ThermalMonitor
from gateway.core.codes import FaultClass
from gateway.hil.bench import run_virtual
from gateway.hil.fitting import scenario_thermal
from gateway.hil.pytest.bench import scenario_of
from gateway.settings.config import parse
from tests.core_calls.step_detector import offsets

NOISE_K = 0.25
WITHIN = 40
"""Samples at 1 Hz."""


def quiet(k=1200, seed=0, sensors=1):
    return NOISE_K * np.random.default_rng(seed).standard_normal((k, 1, sensors))


@pytest.mark.parametrize("size", [-12.0, -3.0, 2.5, 6.0])
def test_a_step_is_found_with_its_size_and_its_return(size):
    z = quiet()
    z[400:800] += size
    off = offsets(z, 1.0)[:, 0, 0]
    assert not off[:400].any()
    assert off[400 + WITHIN : 800] == pytest.approx(size, abs=0.4)
    assert not off[800 + WITHIN :].any()


def stepped(motors, steps, noise_k=NOISE_K, points=(1, 2), there=(0, 1, 2)):
    """(M, 3) K: offsets of sensors that step by `steps` (M,) K at `points`, after 200 of 300 s.

    there: points that have readings.
    """
    duty, flat = np.array([200.0, 2e4, 0.03, 0.08]), np.zeros((motors, 3))
    parameters = np.tile(model.TYPICAL, (motors, 1))
    one = ThermalMonitor(Known(parameters, flat, flat + noise_k, 1.0, duty), 1.0)
    rng = np.random.default_rng(3)
    nothing = np.zeros(motors)
    for k in range(300):
        reading = 20.0 + noise_k * rng.standard_normal((motors, 3))
        reading[:, list(points)] += np.where(k >= 200, steps, 0.0)[:, None]
        reading[:, [q for q in range(3) if q not in there]] = np.nan
        one.add_sample(reading, nothing, nothing, nothing + 20.0)
    return one.offsets


@pytest.mark.parametrize("step_k", [3.0, -12.0])
@pytest.mark.parametrize("motors", [2, 4])
def test_a_step_of_all_points_of_all_motors_is_one(motors, step_k):
    """No train warms so: what the sensors share, as a supply, has stepped. A point may lack."""
    for points in ([0, 1, 2], [1, 2]):
        off = stepped(motors, np.full(motors, step_k), points=points, there=points)
        assert off[:, points] == pytest.approx(step_k, abs=1.0)
    alone = stepped(motors, np.full(motors, step_k), points=[1], there=[1])
    assert not alone.any(), "one point alone may be the model's error"


def test_what_all_sensors_show_is_no_step():
    """But what one shows beyond the others is; alone it has none to compare with."""
    assert not stepped(4, np.full(4, 4.0)).any()
    off = stepped(4, np.array([4.0, 4.0, 9.0, 4.0]))
    assert off[2, 1:] == pytest.approx(5.0, abs=0.6)
    assert not np.delete(off, 2, axis=0).any()
    assert stepped(1, np.array([4.0]))[0, 1:] == pytest.approx(4.0, abs=0.6)
    two = stepped(2, np.array([4.0, 0.0]))
    assert two[0, 1:] == pytest.approx(4.0, abs=0.6)
    assert not two[1].any(), "the one that stands is not accused"
    apart = stepped(2, np.array([4.0, -9.0]))
    assert apart[0, 1:] == pytest.approx(4.0, abs=0.6), "a step the other way explains nothing"
    more = stepped(3, np.array([4.0, 9.0, 9.0]))
    assert not more[0].any(), "a larger one explains it, and makes none the other way"


def test_of_noisy_sensors_a_step_is_larger():
    """2 K: eight times the noise of a median for readings with 0.25 K, but not for 0.5 K."""
    assert stepped(3, np.array([2.0, 0.0, 0.0]))[0, 1:] == pytest.approx(2.0, abs=0.6)
    assert not stepped(3, np.array([2.0, 0.0, 0.0]), noise_k=0.5).any()
    config = step_detector.config(1.0, noise_k=0.5)
    assert config["step_k"].item() == 3.0


@pytest.mark.parametrize("seed", range(8))
def test_a_noisy_sensor_that_steps_back_has_no_offset(seed):
    """A step and the way back are measured with the noise of each: what is left is no offset."""
    noise_k = 0.6
    z = noise_k / NOISE_K * quiet(seed=seed)
    z[400:800] += 9.0
    off = offsets(z, 1.0, noise_k)[:, 0, 0]
    assert off[400 + WITHIN : 800] == pytest.approx(9.0, abs=1.5)
    assert not off[800 + WITHIN :].any()


def test_ten_times_the_rate_is_the_same_sensor():
    z = quiet(12_000)
    z[4000:8000] += 3.0
    off = offsets(z, 0.1)[:, 0, 0]
    assert off[4000 + 10 * WITHIN : 8000] == pytest.approx(3.0, abs=0.3)
    assert not off[:4000].any()
    assert not off[8000 + 10 * WITHIN :].any()


def test_heat_is_no_step():
    """8 K in less than a minute: faster than any fault warms a winding."""
    for seed in range(20):
        z = quiet(seed=seed)
        z[:, 0, 0] += np.interp(np.arange(1200), [300, 355, 700, 760], [0.0, 8.0, 8.0, 0.0])
        assert not offsets(z, 1.0).any()


def test_bursts_of_a_loose_connector_leave_no_offset():
    for seed in range(5):
        z = quiet(3600, seed)
        begins = np.flatnonzero(np.random.default_rng([seed, 1]).random(3600) < 0.01)
        for begin in begins:
            z[begin : begin + 5] += 25.0
        assert np.mean(offsets(z, 1.0) != 0.0) < 0.06


def test_holes_say_nothing_and_a_step_behind_one_is_found():
    z = quiet(sensors=2)
    z[::3, 0, 0] = np.nan
    z[395:420, 0, 0] = np.nan
    z[400:, 0, 0] += 5.0
    z[:, 0, 1] = np.nan
    off = offsets(z, 1.0)
    assert not off[:400].any()
    assert off[500:, 0, 0] == pytest.approx(5.0, abs=0.5)
    assert not off[:, 0, 1].any()


def test_what_comes_later_changes_nothing_and_snapshots_know_no_steps():
    z = quiet()
    z[400:800] += 4.0
    np.testing.assert_array_equal(offsets(z[:700], 1.0), offsets(z, 1.0)[:700])
    assert not offsets(z, 60.0).any()


CONFIG = parse({"thermal": scenario_thermal()})
CODEC = bind(CONFIG.dbc_path, CONFIG.nodes)
HEAT = {
    FaultClass.OVERHEATING, FaultClass.COOLING_LOSS, FaultClass.BEARING,
    FaultClass.WINDING_RESISTANCE,
}  # fmt: skip
UNTOLD = {FaultClass.UNKNOWN, FaultClass.NONE}


def told(kind, value, sensor, seed):
    """Classes told of the drive that is ill, and of the others, within 22 s of its begin."""
    event = {"at_s": 8.0, "drive": 2, "kind": kind, "value": value}
    event |= {"sensor": sensor} if sensor else {}
    tables = {"seed": seed, "duration_s": 30, "drives": 3, "event": [event]}
    ill, others = set(), set()

    def look(now, received, sent, gateway):
        for drive in gateway.view.drives:
            (ill if drive.node == 2 else others).add(drive.fault_class)

    run_virtual(scenario_of(tables, kind), CONFIG, CODEC, [look])
    return ill - UNTOLD, others - UNTOLD


@pytest.mark.parametrize(
    ("kind", "watts", "sensor"),
    [
        ("overheating", 300.0, None),
        ("bearing", 240.0, "drive_end"),
        pytest.param("overheating", 1000.0, None, marks=pytest.mark.thorough),
        pytest.param("overheating", 5000.0, None, marks=pytest.mark.thorough),
        pytest.param("bearing", 1000.0, "non_drive_end", marks=pytest.mark.thorough),
    ],
)
def test_quick_heat_is_no_sensors(kind, watts, sensor):
    ill, others = told(kind, watts, sensor, 31)
    assert ill, "it is told"
    assert ill <= HEAT
    assert not others


@pytest.mark.parametrize(("kelvins", "sensor"), [
    (3.0, "stator"), pytest.param(40.0, "drive_end", marks=pytest.mark.thorough),
])  # fmt: skip
def test_a_sensor_that_steps_is_not_heat(kelvins, sensor):
    assert told("sensor_bias", kelvins, sensor, 32) == ({FaultClass.SENSOR_BIAS}, set())
