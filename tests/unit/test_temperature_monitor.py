"""`gateway/core/thermal.c` on rows of any sort: of frames, of a recording, and by the reference."""

import copy
from pathlib import Path

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import FLAG_INPUTS
from gateway.core.codes import NEVER, FaultClass, FaultSensor, Flag, Reason
from gateway.core.supervision import Supervision
from gateway.hil.fitting import scenario_thermal
from gateway.settings import calibration
from tests.columns import slow_of
from tests.reference import thermal as reference
from tests.reference.trend import Trend
from tests.sender import MS, codec_for
from tests.stations import (
    Inbox,
    TemperatureMonitor,
    Temperatures,
    is_fresh,
    not_yet_valid,
    sensor_verdict,
    sensors_valid,
    temperatures_of,
)

NODES = (1, 2, 3)
CODEC = codec_for(NODES)
FITTED = (("stator", "drive_end", "non_drive_end"), ("stator", "non_drive_end"), ("drive_end",))
TOP_C, RATED_A = 300.0, [25.0] * 3


class Bus:
    """Rows of temperatures as the receiver leaves them; what else drives say comes and goes."""

    def __init__(self, seed):
        self.inbox = Inbox(CODEC, NODES, 10 * MS, Supervision(NODES, 300 * MS))
        self.places = self.inbox.places([1.0] * 3)
        self.rng = np.random.default_rng(seed)
        self.level = np.tile([60.0, 50.0, 48.0, 20.0], (3, 1))
        self.off, self.lost = np.zeros((3, 4)), np.zeros((3, 4), dtype=bool)
        self.held = np.zeros((3, 4), dtype=bool)
        self.gone, self.idle = np.zeros((2, 3), dtype=bool)
        self.colder_k = np.zeros(3)
        self.now = self.tick = 0

    def _change(self):
        rng = self.rng
        if rng.random() < 0.02:
            self.off[rng.integers(3)] = rng.choice([0.0, 9.0, -9.0, 250.0])
            self.off[rng.integers(3), rng.integers(4)] = rng.choice([0.0, 3.0, 9.0])
        for what in (self.lost, self.held):
            if rng.random() < 0.02:
                what[rng.integers(3), rng.integers(4)] ^= True
            if rng.random() < 0.02:
                what[rng.integers(3)] ^= True
        if rng.random() < 0.02:
            self.gone[rng.integers(3)] ^= True
        if rng.random() < 0.05:
            for what in (self.off, self.lost, self.held, self.gone):
                what[:] = 0
        slow, state = slow_of(self.inbox.receiver.drives), self.inbox.receiver.channels
        for column in (slow.speed, slow.irms, slow.command):
            column[:] = np.where(rng.random(3) < 0.03, np.nan, rng.normal(0.0, 20.0, 3))
        # Mostly known, so that the model is fed.
        slow.irms[:] = np.where(np.isnan(slow.irms) & (rng.random(3) < 0.9), 5.0, slow.irms)
        slow.irms[self.idle] = 0.0
        state["good_ns"] = self.now - rng.choice([0, 10, 5000], len(state)) * MS
        state["reason"] = rng.choice([Reason.NONE] * 9 + [Reason.STALE], len(state))

    def go_on(self):
        """The next tick's rows."""
        rng, inbox, space = self.rng, self.inbox, self.inbox.receiver.space
        self.seen = 0
        self._change()
        self.tick += 1
        hole = self.tick % 700 == 0
        self.now += 12_000 * MS if hole else int(rng.choice([10] * 20 + [7, 40])) * MS
        self.level[:, :3] += rng.normal(0.02, 0.01, (3, 3)) * (self.tick < 400)
        for j, drive in enumerate(inbox.drives):
            if self.gone[j] or (self.tick + 3 * j) % 10:
                continue
            channel = drive.channels["Temperatures"]
            row = 2 * j + 1
            space["temperature_rows"][self.seen] = row
            self.seen += 1
            space["channel"][row], space["t_ns"][row] = channel.row, self.now - MS
            picked = list(channel.picked)
            shaky = np.where(self.held[j], 0.0, rng.normal(0.0, 0.15, 4))
            celsius = self.level[j] + self.off[j] + shaky - self.colder_k[j]
            celsius = np.minimum(np.round(celsius, 1), TOP_C)
            space["value"][row, picked] = celsius
            space["validity"][row, picked] = np.where(self.lost[j], rng.integers(1, 4, 4), 0)
            space["value"][row, channel.quality] = rng.choice([1.0] * 40 + [0.0, 2.0, 3.0])
        inbox.receiver.tick["temperatures"] = self.seen


def cells():
    return calibration.load(Path(scenario_thermal()["calibration"]), NODES, 5.0)


def made(method, seed, fitted=FITTED):
    """A thermal side, its bus and its reference."""
    learnt = None if method == "none" else cells()
    side = TemperatureMonitor(3, 100 * MS, 5.0, learnt, NODES, fitted, model=method == "model")
    bus, limits = Bus(seed), [310 * MS, 310 * MS, 150 * MS]
    side.wire(bus.places, limits, RATED_A)
    # A window and a second of the calibration's length in cycles.
    plain = reference.Temperatures(side, learnt, NODES, 50, 10, limits, 0.03 * RATED_A[0])
    return side, bus, plain


def loads_of(bus):
    """(N, 2) current and speed that are known and fresh."""
    inbox, out = bus.inbox, np.full((3, 2), np.nan)
    for drive, row, load in zip(inbox.drives, inbox.receiver.drives, out, strict=True):
        if not np.isnan(row["irms"]) and is_fresh(bus.inbox, drive.status.row, bus.now):
            load[0] = row["irms"]
        if is_fresh(bus.inbox, drive.motion.row, bus.now):
            load[1] = row["speed"]
    return out


def everything(side):
    """All that goes on to the next tick."""
    parts = [side.record[name].tolist() for name in ("next_ns", "cycles", "cycle", "dirty")]
    if side.model is not None:
        parts.append(side.model.motors.tolist())
    return repr([*parts, side.motors.tolist(), *map(np.ndarray.tolist, side.window), side._ring])


@pytest.mark.parametrize(("method", "seed"), [("none", 1), ("maisd", 2), ("model", 3)])
def test_it_equals_the_reference_and_a_recording_is_as_good_as_frames(method, seed):
    """Sensors that fail in every way, silent drives, one that is cut out, ticks of any length."""
    side, bus, plain = made(method, seed)
    other, _, _ = made(method, seed)
    inputs, again, met = np.zeros(3, FLAG_INPUTS), np.zeros(3, FLAG_INPUTS), set()
    current = set()
    for tick in range(3000):
        bus.idle[0], bus.colder_k[0] = tick < 1000, np.clip((2000 - tick) / 40, 0.0, 12.0)
        bus.go_on()
        side.hear(bus.inbox, bus.now, inputs)
        for reading in temperatures_of(bus.inbox):
            celsius, valid = reading.celsius[3], reading.valid[3]
            plain.ambient[reading.drive] = celsius if valid else np.nan
        plain.tick(bus.seen > 0, bus.now, loads_of(bus))
        other.add_readings(temperatures_of(bus.inbox), bus.now, bus.inbox.receiver)
        other.tell(bus.now, again)
        assert repr(inputs.tolist()) == repr(again.tolist())
        np.testing.assert_allclose(side.motors["mean"], plain.mean, rtol=1e-12)
        for k in range(3):
            told, wanted = side.to_report(k, inputs[k]), plain.report(k, bus.now)
            assert tuple(told[:5]) == wanted[:5], (tick, k)
            numbers = [inputs[k]["mixed_c"], inputs[k]["maisd_k"]]
            np.testing.assert_allclose(numbers, wanted[5:], rtol=1e-9, atol=1e-9)
            met.add((told.reason, told.fault_class))
            current.add((k, bool(side.currents["cut_out"][k]), bool(side.motors["left_out"][k])))
    assert everything(side) == everything(other)
    assert {FaultClass.SENSOR_BIAS, FaultClass.SENSOR_LOST} <= {kind for _, kind in met}
    assert {Reason.STALE, Reason.NOT_AVAILABLE} <= {reason for reason, _ in met}
    driven = {(k, False, False) for k in range(3)}
    assert current == driven | {(0, True, True), (0, False, True)}


@pytest.mark.parametrize("coolest", [0, 1])
@pytest.mark.parametrize("point", range(3))
@pytest.mark.parametrize(("below_k", "stays"), [(5.2, True), (5.0, False), (4.8, False)])
def test_a_motor_that_was_cut_out_waits_until_it_is_as_warm_as_the_coolest(
    coolest, point, below_k, stays
):
    """At each point, less the limit of 5 K; motors that are left out, or none of the train's, are
    no measure."""
    side = TemperatureMonitor(5, 100 * MS, 0.1, None, (1, 2, 3, 4, 5))
    side.record["drive_count"], side.record["window"]["apart_k"] = 4, 5.0
    side.motors["left_out"][2:4] = 1
    levels = np.full((5, 3), 50.0)
    levels[coolest, point], levels[2, point] = 45.0, 45.0 - below_k
    levels[3:] = 20.0
    side.window.known[4], side.window.centred[4] = True, 20.0
    for k in range(3):
        side.add_readings(
            [Temperatures(j, k * 100 * MS, (*row, 20.0), (True,) * 4, (0, k, k, k))
             for j, row in enumerate(levels.tolist()[:4])], k * 100 * MS,
        )  # fmt: skip
    assert side.motors["left_out"].tolist() == [0, 0, stays, 1, 0]
    assert side.window.compared[:4].all(axis=1).tolist() == [True, True, not stays, False]


def test_a_copy_goes_on_by_itself():
    side, bus, _ = made("model", 5)
    inputs = np.zeros(3, FLAG_INPUTS)
    for _ in range(200):
        bus.go_on()
        side.hear(bus.inbox, bus.now, inputs)
    other, before = copy.deepcopy(side), everything(side)
    assert everything(other) == before
    for _ in range(200):
        bus.go_on()
        other.hear(bus.inbox, bus.now, inputs)
    assert everything(side) == before != everything(other)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_of_the_model_in_any_state_equals_the_reference(seed):
    rng = np.random.default_rng(seed)
    side, bus, _ = made("model", 3)
    inputs, met = np.zeros(3, FLAG_INPUTS), set()
    while sensors_valid(side.sensors, bus.now).sum() < 6 or bus.tick < 100:
        bus.go_on()
        bus.lost[:], bus.off[:], bus.gone[:] = False, 0.0, False
        side.hear(bus.inbox, bus.now, inputs)
    motors, unexplained = side.model.motors, side.model.known_motors["unexplained"]
    out, faulty = side.currents, set()
    for _ in range(1000):
        unexplained[:] = rng.random(3) < 0.1
        side.sensors.drives["sensor"]["bias_k"] = np.where(rng.random((3, 3)) < 0.03, 4.0, 0.0)
        motors["unknown_s"] = rng.choice([0.0, 5.0, 5.1], 3, p=[0.8, 0.1, 0.1])
        motors["judged"], out["cut_out"] = rng.random(3) < 0.9, rng.random(3) < 0.1
        motors["off_k"] = np.where(rng.random((3, 3)) < 0.4, np.nan, 1.0)
        motors["held"] = rng.random(3) < 0.6
        motors["fault_probability"] = rng.choice([0.5, 0.51], 3)
        steps = np.where(rng.random((3, 3)) < 0.1, 4.0, 0.0)
        steps[rng.random(3) < 0.05] = 4.0
        motors["step"]["offset_k"] = steps
        motors["step"]["level_k"] = rng.choice([0.0, np.nan], (3, 3), p=[0.9, 0.1])
        motors["step"]["since"] = rng.choice([-1, 0], (3, 3), p=[0.8, 0.2])
        for k in range(3):
            parts = np.array([0.0, *np.sort(rng.random(10)), 1.0])
            part = np.diff(parts)
            hidden = rng.choice(3, p=[0.4, 0.4, 0.2])
            part[[slice(5, 8), slice(0, 5), slice(0, 0)][hidden]] *= 1e-4
            part[8:] *= rng.choice([0.0, 1.0, 5.0])
            motors["kind"][k] = part / part.sum()
        kinds = side.model.kinds()[0]
        for k in range(3):
            side.motors["valid_until_ns"] = NEVER
            told = side.report(k, bus.now, 1 << 60)
            words = reference.words(motors[k], kinds[k], unexplained[k], out["cut_out"][k])
            fault, whose = sensor_verdict(side.sensors, k, bus.now)
            if fault is not FaultClass.NONE:
                wanted = reference.beside_fault(fault, whose, words)
                faulty.add(wanted[0])
            else:
                sensor = Flag.UNKNOWN if not_yet_valid(side.sensors, k) else Flag.GOOD
                thermal, own, *rest = words
                wanted = (thermal, sensor if own is None else own, *rest)
            assert tuple(told[:5]) == wanted
            met.add(wanted)
    assert {kind for *_, kind, _ in met} >= set(FaultClass) - {
        FaultClass.SENSOR_STUCK, FaultClass.SENSOR_LOST,
    }  # fmt: skip
    assert {whose for *_, whose in met} == set(FaultSensor) - {
        FaultSensor.AMBIENT, FaultSensor.CURRENT,
    }  # fmt: skip
    assert Reason.CONFIG in {reason for _, _, reason, *_ in met}
    assert faulty == {Flag.BAD, Flag.UNKNOWN}, "hot beside a faulty sensor, or not known"
    undecided = {thermal for thermal, _, _, kind, _ in met if kind is FaultClass.UNKNOWN}
    assert undecided == {Flag.BAD, Flag.UNKNOWN}, "a fault without a class is raised"


@pytest.mark.parametrize("seed", range(2))
def test_evidence_by_comparison_in_any_state_equals_the_reference(seed):
    rng = np.random.default_rng(seed)
    side, bus, plain = made("maisd", 3, [FITTED[0]] * 3)
    inputs, met, sensor = np.zeros(3, FLAG_INPUTS), set(), side.sensors.drives["sensor"]
    while not_yet_valid(side.sensors, 0) or bus.tick < 100:
        bus.go_on()
        bus.lost[:], bus.off[:], bus.gone[:], bus.held[:] = False, 0.0, False, False
        side.hear(bus.inbox, bus.now, inputs)
    for _ in range(500):
        side.motors["left_out"] = plain.left_out = rng.random(3) < 0.1
        side.currents["cut_out"] = plain.cut_out = plain.left_out & (rng.random(3) < 0.5)
        side.window.known[:] = plain.known = rng.random((3, 3)) < 0.97
        side.window.compared[:] = plain.known & ~plain.left_out[:, None]
        side.window.deviation[:] = rng.choice([0.0, 50.0, np.nan], (3, 3), p=[0.6, 0.37, 0.03])
        side.spread[:] = rng.choice([0.0, 40.0, 50.0, np.nan], 3, p=[0.2, 0.3, 0.4, 0.1])
        plain.deviation, plain.spread = side.window.deviation.copy(), side.spread.copy()
        sensor["moved"], sensor["near"] = rng.random((3, 3)) < 0.7, rng.random((3, 3)) < 0.5
        plain.averages = side.window.mean.copy()
        for k in range(3):
            side.motors["valid_until_ns"] = NEVER
            told, wanted = side.report(k, bus.now, 1 << 60), plain._judge(k, bus.now)
            assert tuple(told[:5]) == wanted[:5]
            assert repr(told[6]) == repr(None if np.isnan(wanted[6]) else float(wanted[6]))
            met.add(told[:5])
    assert {
        Reason.CONFIG,
        Reason.STARTING,
        Reason.DIVERGED,
        Reason.TOO_FEW_DRIVES,
        Reason.NONE,
    } == {reason for _, _, reason, *_ in met}


def test_a_step_of_a_sensor_is_a_jump_and_blocks_are_observed():
    side, bus, _ = made("model", 3, [FITTED[0]] * 3)
    inputs, model, trend = np.zeros(3, FLAG_INPUTS), side.model, Trend(3)
    steps, jumps, blocks, seconds = model.offsets.copy(), np.zeros(3, int), 0, 0
    for tick in range(3000):
        bus.go_on()
        bus.lost[:], bus.off[:], bus.gone[:], bus.held[:] = False, 0.0, False, False
        if tick % 500 == 7:
            model.motors["step"]["offset_k"][tick // 500 % 3, 0] = tick % 1000
        cycles, position = side.record["cycles"].item(), model.record["position"].item()
        held = model.motors["held"] != 0
        side.hear(bus.inbox, bus.now, inputs)
        if side.record["cycles"].item() == cycles or side.last is None:
            assert model.record["position"].item() == position
            continue
        seconds += 1
        jumps += (model.offsets != steps).any(axis=1)
        steps = model.offsets.copy()
        if model.record["position"].item() == 0:
            blocks += 1
            beside = np.nanmean(model.motors["off_k"] + model.motors["base_k"], axis=1)
            trend.take(np.where(held, np.nan, beside), (model.block * model.dt_s) / 3600.0)
            # What the block was compared with may have been learnt anew since, in the same tick.
            np.testing.assert_allclose(side.motors["trend"]["level_k"], trend.level, atol=1e-3)
    assert side.motors["jumps"].tolist() == inputs["jumps"].tolist() == jumps.tolist()
    assert (jumps >= 2).all()
    assert seconds == side.record["cycles"].item() // 10
    assert (model.motors["judged"] > 0).any()
    observed = side.motors["trend"]["observed_h"] / ((model.block * model.dt_s) / 3600.0)
    assert blocks > 3
    assert 0 < observed.max() <= blocks + 1e-9


def test_a_reset_forgets_all_but_the_places():
    (side, bus, _), (fresh, _, _) = made("none", 5), made("none", 5)
    for _ in range(205):
        bus.go_on()
        side.hear(bus.inbox, bus.now, np.zeros(3, FLAG_INPUTS))
    assert side.motors.tobytes() != fresh.motors.tobytes()
    side.record["second_complete"] = 1
    lib.temperatures_reset(side.pointer)
    assert repr(side.motors.tolist()) == repr(fresh.motors.tolist())
    names = ("next_ns", "next_report_ns", "cycles", "cycle", "second_complete", "dirty")
    assert [side.record[name].item() for name in names] == [NEVER, 0, 0, 0, 0, 1]


def test_a_motor_is_stale_from_the_first_nanosecond_beyond_its_limit():
    side, out = TemperatureMonitor(1, 100 * MS, 2.0, None, NODES[:1]), np.zeros(1, FLAG_INPUTS)
    side.motors["age_limit_ns"] = 50 * MS
    side.add_readings([Temperatures(0, 0, (50.0,) * 4, (True,) * 4, (500,) * 4)], 0)
    for now, reason in ((0, Reason.CONFIG), (50 * MS, Reason.CONFIG), (50 * MS + 1, Reason.STALE)):
        side.record["dirty"] = 1
        side.tell(now, out)
        assert out["thermal_reason"][0] == reason


def test_evidence_is_told_where_it_can_have_changed():
    """Once a period, in the first nanosecond in which it is stale, and then no more."""
    side, out = TemperatureMonitor(1, 100 * MS, 2.0, None, NODES[:1]), np.zeros(1, FLAG_INPUTS)
    side.motors["age_limit_ns"] = 150 * MS
    side.add_readings([Temperatures(0, 0, (50.0,) * 4, (True,) * 4, (500,) * 4)], 0)

    def is_told(now):
        out["jumps"] = 99
        side.tell(now, out)
        return out["jumps"][0] != 99

    times = (0, 1, 100 * MS - 1, 100 * MS, 150 * MS, 150 * MS + 1, 10_000 * MS)
    assert [now for now in times if is_told(now)] == [0, 100 * MS, 150 * MS + 1]


def test_a_temperature_that_no_sensor_has_is_taken_as_it_is():
    """From a DBC of any range: neither its tenths nor its mean fail."""
    side, bus, _ = made("maisd", 3)
    inputs, space = np.zeros(3, FLAG_INPUTS), bus.inbox.receiver.space
    for tick in range(400):
        bus.go_on()
        seen = bus.seen
        for row in space["temperature_rows"][:seen]:
            picked = list(bus.inbox.channels[space["channel"][row]].picked)
            space["value"][row, picked] = (1e300, -1e300, 9e14, np.inf)[tick % 4]
            space["validity"][row, picked] = 0
        side.hear(bus.inbox, bus.now, inputs)
    assert set(inputs["thermal"].tolist()) <= {0, 1, 2}


def test_an_absent_receiver_is_no_load():
    side = TemperatureMonitor(3, 100 * MS, 2.0, None, NODES)
    for k in range(11):
        side.add_readings([Temperatures(0, k * 100 * MS, (50.0,) * 4, (True,) * 4, (500,) * 4)],
                  k * 100 * MS)  # fmt: skip
    assert np.isnan(side.last.square).all() if side.last else True
    np.testing.assert_array_equal(side.motors["mean"][:, 3:5], np.nan)


def test_a_drive_without_quality_status_or_motion_has_no_load_and_readings_that_count():
    """As of a mapped inverter."""
    side, bus, _ = made("none", 3)
    bus.inbox.receiver.channels["quality"] = -1
    side.motors["status"] = side.motors["motion"] = -1
    inputs = np.zeros(3, FLAG_INPUTS)
    for _ in range(400):
        bus.go_on()
        side.hear(bus.inbox, bus.now, inputs)
    np.testing.assert_array_equal(side.motors["mean"][:, 3:5], np.nan)
    assert np.isfinite(side.motors["mean"][:, 0]).any()


def test_loads_may_come_in_the_first_channel_of_all():
    side, bus, _ = made("none", 3)
    side.motors["status"] = side.motors["motion"] = 0
    for _ in range(400):
        bus.go_on()
        side.hear(bus.inbox, bus.now, np.zeros(3, FLAG_INPUTS))
    assert np.isfinite(side.motors["mean"][:, 3:5]).any(axis=0).all()


@pytest.mark.parametrize(("gain", "limit_k", "thermal"), [
    (1.0, 0.5, Flag.BAD), (1.0, 1e9, Flag.GOOD), (0.0, 0.5, Flag.UNKNOWN),
])  # fmt: skip
def test_maisd_raises_where_the_fleet_differs_and_a_sensor_of_gain_0_raises_nothing(
    gain, limit_k, thermal
):
    """Who stood still while the fleet was learnt from is infinitely far, or nowhere."""
    side, now = TemperatureMonitor(3, 100 * MS, 2.0, cells(), NODES), 0
    side.window.gain[:], side.window.offset_k[:] = 1.0, 0.0
    side.window.gain[:, 1] = gain
    side.record["window"]["limit_k"], side.record["window"]["apart_k"] = limit_k, 1.0
    for k in range(100):
        now = k * 100 * MS
        warm = 0.1 * k
        side.add_readings(
            [
                Temperatures(
                    j, now, (60.0, 50.0 + warm * (j == 1) + 0.1 * (k % 2), 50.0, 20.0), (True,) * 4,
                    (600, round(500 + 10 * warm * (j == 1)) + k % 2, 500, 200),
                )
                for j in range(3)
            ],
            now,
        )  # fmt: skip
    assert side.report(1, now, 310 * MS).thermal is thermal
    side.record["window"]["limit_k"] = side.motors["evidence"]["maisd_k"][1]
    side.motors["valid_until_ns"] = NEVER
    assert side.report(1, now, 310 * MS).thermal is min(thermal, Flag.GOOD), "no more than that"
