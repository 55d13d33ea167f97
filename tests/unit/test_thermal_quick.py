"""A small motor's heat, however quick, is heat; its sensors' steps are its sensors'. The others'
are well: of three motors two are left to compare each with."""

import pytest

from dbc.codec import bind
from gateway.core.codes import FaultClass
from gateway.hil.bench import run_virtual
from gateway.hil.fitting import scenario_thermal
from gateway.hil.pytest.bench import scenario_of
from gateway.settings.config import parse

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
