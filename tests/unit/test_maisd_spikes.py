"""`method = "maisd"` through the whole gateway: what one drive's sensors do makes no motor hot.

Whole kinds: amplitudes from -100 to 100 K, one drive or two, trains of 3 to 8, from the cold and
hot from the start. Readings come ten times a second, by the tenth of a degree.
"""

from __future__ import annotations

import numpy as np
import pytest

from dbc.e2e import protect
from dbc.frame import SECOND, Frame
from dbc.frames import block_of
from gateway.core.codes import FaultClass, Flag
from gateway.core.flags import FlagKind
from gateway.core.gateway import Gateway
from gateway.io.prepare import prepare
from gateway.io.replay import Briefly, replay
from gateway.settings.calibration import to_toml
from tests.fleet_limits import calibration, motor

AMPLITUDES_K = (-100.0, -60.0, -25.0, 25.0, 60.0, 100.0)
DRIVES = (3, 4, 5, 8)
STARTS_C = (-15.0, 25.0, 130.0)
STEP = 10
"""Readings a second."""
GAINS = (0.99, 1.03, 1.0, 1.01, 0.98, 1.02, 1.0, 0.99)
OFFSETS_K = (-0.2, 0.5, -0.6, 0.1, 0.3, -0.4, 0.2, 0.0)


def setup(folder, drives):
    """Configuration and codec of a calibrated train."""
    nodes = range(1, drives + 1)
    each = zip(nodes, GAINS, OFFSETS_K, strict=False)
    motors = (motor(*own, step_k=0.8) for own in each)
    (folder / "learnt.toml").write_text(to_toml(calibration(motors, window_s=5.0)))
    path = folder / "train.toml"
    each = "".join(f"[[drive]]\nnode = {node}\n" for node in nodes)
    path.write_text(f'[thermal]\nmethod = "maisd"\ncalibration = "learnt.toml"\n{each}')
    return prepare(path)


def sound(drives, seconds, start_c, seed=1):
    """(L, N, 4) degC: motors equally warm at the start that warm up, and the air."""
    t_s = np.arange(seconds * STEP)[:, None, None] / STEP
    place = np.array([*OFFSETS_K[:drives]])[None, :, None] * 0.5
    warming = np.array([0.06, -0.02, -0.03, 0.0])
    noise = np.random.default_rng(seed).normal(0.0, 0.12, (seconds * STEP, drives, 4))
    return start_c + place + warming * t_s + noise


def flags_of(setting, celsius, last=None):
    """A replay: the (drive, class) of all that was ever hot, and of all faults of sensors.

    last: gets the states of the first drive's flags at the end.
    """
    config, codec = setting
    frames = []
    for j, node in enumerate(config.nodes):
        spec = codec.by_name[f"Drive{node}_Temperatures"]
        names = ("Quality", "Tstator", "Tde", "Tnde", "Tambient")
        table = np.column_stack([np.ones(len(celsius)), np.clip(celsius[:, j], -60.0, 300.0)])
        for k, payload in enumerate(codec.encode_rows(spec, names, table)):
            protect(spec, payload, k)
            stamp = SECOND + k * SECOND // STEP + 100_000 * j
            frames.append(Frame(stamp, spec.can_id, bytes(payload)))
    hot, sensors = set(), set()

    def changed(gateway):
        status = gateway.status.drives
        for name, found in ((FlagKind.THERMAL, hot), (FlagKind.SENSOR, sensors)):
            for j in np.flatnonzero(status["flag"]["state"][:, name] == Flag.BAD).tolist():
                found.add((j, FaultClass(status["fault_class"][j])))
        if last is not None:
            last[:] = status["flag"]["state"][0, [FlagKind.THERMAL, FlagKind.SENSOR]].tolist()

    replay(
        [block_of(sorted(frames))], lambda start: Gateway(config, codec, start),
        config.loop.period_ns, Briefly(lambda _: None, changed),
    )  # fmt: skip
    return hot, sensors


def spikes(celsius, length, who=(0,), points=(0,)):
    """Every 15 s another amplitude, for so many readings."""
    for k, amplitude in enumerate(AMPLITUDES_K):
        at = (12 + 15 * k) * STEP
        celsius[at : at + length][np.ix_(range(length), who, points)] += amplitude


@pytest.mark.parametrize("start_c", STARTS_C)
@pytest.mark.parametrize("drives", DRIVES)
def test_a_train_that_starts_hot_or_cold_has_no_hot_motor(tmp_path, drives, start_c):
    """However its motors differ once they are warm by their own losses."""
    assert flags_of(setup(tmp_path, drives), sound(drives, 60, start_c)) == (set(), set())


@pytest.mark.parametrize("length", [1, 2, 5])
@pytest.mark.parametrize("drives", DRIVES)
def test_bad_readings_make_no_motor_hot(tmp_path, drives, length):
    """Two of -100 K on one drive made two others `Overheating` for nine seconds."""
    setting = setup(tmp_path, drives)
    for start_c, who, points in (
        (25.0, (0,), (0,)),
        (130.0, (1,), (0, 1, 2)),
        (130.0, (0, 2), (1,)),
    ):
        celsius = sound(drives, 105, start_c)
        spikes(celsius, length, who, points)
        assert flags_of(setting, celsius)[0] == set(), (start_c, who)


@pytest.mark.parametrize("every_s", [0.3, 1, 10, 11])
@pytest.mark.parametrize("drives", [3, 8])
def test_a_code_that_comes_again_and_again_makes_no_motor_hot(tmp_path, drives, every_s):
    """0xFF of a byte is 215 degC: one reading every ten seconds held the fault to the end."""
    setting = setup(tmp_path, drives)
    for code_c in (-40.0, 215.0, 300.0):
        celsius = sound(drives, 60, 60.0)
        celsius[10 * STEP :: round(every_s * STEP), 0, 0] = code_c
        assert flags_of(setting, celsius)[0] == set(), code_c


@pytest.mark.parametrize("start_c", [25.0, 130.0])
@pytest.mark.parametrize("drives", DRIVES)
def test_a_loose_contact_makes_no_motor_hot(tmp_path, drives, start_c):
    """Bursts of any length and size, for good."""
    setting = setup(tmp_path, drives)
    rng = np.random.default_rng(drives)
    for amplitude in AMPLITUDES_K:
        celsius = sound(drives, 60, start_c)
        away = np.cumsum(rng.random(len(celsius)) < 0.08) % 2 == 1
        away[: 5 * STEP] = False
        size = np.where(rng.random(len(celsius)) < 0.5, 1.0, rng.random(len(celsius)))
        celsius[:, 0, 0] += away * amplitude * size
        assert flags_of(setting, celsius)[0] == set(), amplitude


@pytest.mark.parametrize("start_c", STARTS_C)
@pytest.mark.parametrize("drives", DRIVES)
def test_a_sensor_that_steps_is_named_and_no_motor(tmp_path, drives, start_c):
    setting = setup(tmp_path, drives)
    for amplitude in AMPLITUDES_K:
        celsius = sound(drives, 40, start_c)
        celsius[15 * STEP :, 1, 0] += amplitude
        assert flags_of(setting, celsius) == (set(), {(1, FaultClass.SENSOR_BIAS)}), amplitude


@pytest.mark.parametrize("portion_k", [-30.0, 25.0, 60.0])
def test_a_sensor_that_steps_in_equal_portions_is_named_and_no_motor(tmp_path, portion_k):
    """150, 190, 252, 300 degC, a reading each, was called heat."""
    celsius = sound(3, 40, 130.0)
    celsius[15 * STEP :, 1, 0] += portion_k * np.minimum(np.arange(1, 25 * STEP + 1), 3)
    assert flags_of(setup(tmp_path, 3), celsius) == (set(), {(1, FaultClass.SENSOR_BIAS)})


@pytest.mark.parametrize("start_c", STARTS_C)
@pytest.mark.parametrize("drives", [2, *DRIVES])
def test_a_sensor_that_is_off_from_the_start_makes_no_motor_hot(tmp_path, drives, start_c):
    """Moving with its motor, +100 K above it: it may be heat, or it may not. It is neither."""
    setting = setup(tmp_path, drives)
    for amplitude in (-100.0, -60.0, 60.0, 100.0):
        celsius = sound(drives, 40, start_c)
        celsius[:, 0, 0] += amplitude
        assert flags_of(setting, celsius)[0] == set(), amplitude


def test_of_a_point_far_above_from_the_start_on_both_flags_are_unknown(tmp_path):
    celsius, last = sound(3, 40, 25.0), []
    celsius[:, 0, 0] += 100.0
    flags_of(setup(tmp_path, 3), celsius, last)
    assert last == [Flag.UNKNOWN, Flag.UNKNOWN]


@pytest.mark.parametrize("moving", [True, False])
def test_a_reading_that_has_never_changed_is_not_hot_and_one_that_has_is(tmp_path, moving):
    celsius = sound(3, 40, 25.0)
    celsius[:, 0, 0] += 20.0
    if not moving:
        celsius[:, 0, 0] = 46.0
    assert bool(flags_of(setup(tmp_path, 3), celsius)[0]) == moving


@pytest.mark.parametrize("start_c", STARTS_C)
@pytest.mark.parametrize("drives", [2, *DRIVES])
def test_the_motor_that_grows_hot_is_named(tmp_path, drives, start_c):
    """Also while another drive's contact is loose, and where it was far above before the start."""
    setting = setup(tmp_path, drives)
    which = drives - 1
    for at_once_k in (0.0, 70.0):
        celsius = sound(drives, 60, start_c)
        rise = at_once_k + np.maximum(np.arange(60 * STEP) / STEP - 10.0, 0.0) * 0.4
        celsius[:, which, :3] += rise[:, None] * np.array([1.0, 0.3, 0.3])
        if drives > 2:
            celsius[:: 3 * STEP, 0, 0] -= 80.0
        hot = flags_of(setting, celsius)[0]
        assert {drive for drive, _ in hot} == {which}, at_once_k
