"""The thermal model on the bus: seconds, what is learnt and stored, what is said when blind."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from estimators.thermal import model
from estimators.thermal.model import TYPICAL, Inputs, predict
from estimators.thermal.monitor import OWN_K
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from gateway.core.supervision import Supervision
from gateway.hil.fitting import scenario_thermal
from gateway.settings import calibration
from gateway.settings.calibration import (
    POINTS,
    Calibration,
    FleetHeat,
    MotorCalibration,
    MotorHeat,
    to_toml,
)
from gateway.settings.config import ConfigError
from gateway.study.calibrating import Learner, Sample
from tests.sender import codec_for
from tests.stations import Inbox, TemperatureMonitor, Temperatures

MS = 1_000_000
NODES = (1, 2, 3)


class Line(NamedTuple):
    """A drive's Status and Motion, as fresh as told; None: not sent yet."""

    irms: float | None = 10.0
    speed: float | None = -25.0
    fresh: bool = True


class Others:
    """What drives have sent beside their temperatures."""

    def __init__(self, nodes, side):
        self.inbox = Inbox(codec_for(nodes), nodes, 10 * MS, Supervision(nodes, 300 * MS))
        side.wire(self.inbox.places([0.0] * len(nodes)), [310 * MS] * len(nodes), [25.0])

    def say(self, lines, now):
        """Each drive's Status and Motion, received at `now`."""
        receiver = self.inbox.receiver
        for drive, inputs, line in zip(self.inbox.drives, receiver.drives, lines, strict=True):
            inputs["irms"], inputs["command"] = (
                (np.nan, np.nan) if line.irms is None else (line.irms, 1.0)
            )
            inputs["speed"] = np.nan if line.speed is None else line.speed
            for channel in (drive.motion, drive.status):
                record = receiver.channels[channel.row]
                record["good_ns"], record["reason"] = now, Reason.NONE
                if not line.fresh:
                    record["reason"] = Reason.STALE
        return receiver


def reading(drive, t_ns, celsius):
    return Temperatures(
        drive, t_ns, tuple(celsius), (True,) * 4, tuple(round(10 * c) for c in celsius)
    )


def shipped():
    path = Path(scenario_thermal()["calibration"])
    return calibration.load(path, NODES, 5.0)


def test_a_second_is_the_mean_of_what_was_known():
    side = TemperatureMonitor(2, 100 * MS, 5.0, None, (1, 2), [("stator", "drive_end"), POINTS])
    lines, others = [Line(), Line(irms=None)], Others((1, 2), side)
    for k in range(10):
        now = (k + 1) * 100 * MS
        pair = [reading(0, now, (50 + k / 10, 40, 30, 20)), reading(1, now, (50, 40, 30, 20))]
        side.add_readings(pair, now, others.say(lines, now))
        assert (side.last is None) == (k < 9)
    assert side.dt_s == 1.0
    sample = side.last
    np.testing.assert_allclose(sample.temperature, [[50.45, 40, np.nan], [50, 40, 30]])
    np.testing.assert_allclose(sample.square, [200.0, np.nan], err_msg="amplitude, from rms")
    np.testing.assert_allclose(sample.speed, 25.0)
    np.testing.assert_allclose(sample.ambient, 20.0)


class Rig:
    """Three motors of the shipped calibration, simulated by their own models."""

    def __init__(self):
        self.cells = shipped()
        self.side = TemperatureMonitor(3, 100 * MS, 5.0, self.cells, NODES, model=True)
        self.known = self.cells.known(NODES)
        self.others = Others(NODES, self.side)
        self.k = 0

    def run(self, seconds, drives=None, extra=None, faulty=None):
        """extra (3, 5): heat in the lumps, K/s; faulty: function of the readings of motor 1."""
        n = 10 * seconds
        lines = drives or [Line(8.0), Line(8.0), Line(8.0)]
        inputs = Inputs(
            np.full((n, 3), 128.0), np.full(n, 25.0), np.full(n, 20.0), np.arange(n), 0.1
        )  # fmt: skip
        start = np.tile([60.0, 45.0, 45.0], (3, 1)) if self.k == 0 else self.last
        out = predict(self.known.parameters, inputs, start, extra)
        rng = np.random.default_rng(self.k)
        for row in out:
            self.k += 1
            now = self.k * 100 * MS
            noisy = np.round(row + rng.normal(0.0, 0.1, (3, 3)), 1)
            beside = self.others.say(lines, now)
            readings = [reading(j, now, (*noisy[j], 20.0)) for j in range(3)]
            if faulty is not None:
                readings[1] = faulty(readings[1])
            self.side.add_readings(readings, now, beside)
        self.last = out[-1]
        return [self.side.report(j, now, 310 * MS) for j in range(3)]


def test_healthy_motors_are_good_and_a_hot_winding_is_named():
    rig = Rig()
    assert {r.reason for r in rig.run(2)} == {Reason.STARTING}
    for report in rig.run(60):
        assert (report.thermal, report.fault_class) == (Flag.GOOD, FaultClass.NONE)
    hot = np.zeros((3, 5))
    hot[1, model.WINDING] = 0.1
    reports = rig.run(30, extra=hot)
    assert [r.thermal for r in reports] == [Flag.GOOD, Flag.BAD, Flag.GOOD]
    assert reports[1].fault_class in (FaultClass.OVERHEATING, FaultClass.WINDING_RESISTANCE)
    assert reports[1].sensor is Flag.GOOD, "the sensor is right: it is hot"


def with_end(celsius):
    """Fault of the sensor at the non-drive end: a function of its reading, None: it is lost."""

    def apply(one):
        *others, end, ambient = one.celsius
        given = celsius(end)
        values = (*others, end if given is None else given, ambient)
        valid = (True, True, given is not None, True)
        return one._replace(celsius=values, valid=valid, raw=tuple(round(10 * c) for c in values))

    return apply


@pytest.mark.parametrize(
    ("celsius", "kind"),
    [
        (lambda _: None, FaultClass.SENSOR_LOST),
        (lambda _: 44.4, FaultClass.SENSOR_STUCK),
        (lambda c: c + 8.0, FaultClass.SENSOR_BIAS),
    ],
)
def test_a_faulty_sensor_hides_no_heat_and_is_none_itself(celsius, kind):
    rig, fault = Rig(), with_end(celsius)
    rig.run(120)
    for report in rig.run(600, faulty=fault)[1:2]:
        assert (report.thermal, report.sensor) == (Flag.UNKNOWN, Flag.BAD)
        assert (report.reason, report.fault_class) == (Reason.NOT_AVAILABLE, kind)
    hot = np.zeros((3, 5))
    hot[1, model.WINDING] = 0.1
    report = rig.run(60, extra=hot, faulty=fault)[1]
    assert (report.thermal, report.sensor, report.reason) == (Flag.BAD, Flag.BAD, Reason.NONE)
    assert report.fault_class in (FaultClass.OVERHEATING, FaultClass.WINDING_RESISTANCE)
    assert report.fault_sensor is FaultSensor.NON_DRIVE_END


@pytest.mark.parametrize("rate", [-0.012, -0.02])
def test_a_sensor_that_crept_and_is_mended_has_no_offset(rate):
    """It steps back by more than a step's limit, which no motor's temperature does."""
    rig, crept = Rig(), np.minimum(np.arange(9000) / 10.0, 500.0) * rate
    rig.run(120)
    creep = iter(crept)
    assert rig.run(900, faulty=with_end(lambda c: c + next(creep)))[1].sensor is Flag.BAD
    assert (rig.side.sensors.drives["sensor"]["limit_k"] < abs(crept[-1])).all()
    mended = rig.run(300)[1]
    assert (mended.thermal, mended.sensor) == (Flag.GOOD, Flag.GOOD)


@pytest.mark.parametrize("line", [Line(fresh=False), Line(irms=None), Line(speed=None)])
def test_blind_is_unknown_and_says_stale(line):
    rig = Rig()
    assert {r.thermal for r in rig.run(20)} == {Flag.GOOD}
    reports = rig.run(10, [line, Line(8.0), Line(8.0)])
    assert (reports[0].thermal, reports[0].reason) == (Flag.UNKNOWN, Reason.STALE)
    assert {r.reason for r in reports[1:]} == {Reason.TOO_FEW_DRIVES}, "one other is too few"
    assert {r.thermal for r in rig.run(20)} == {Flag.GOOD}, "and it comes back"


def cells(with_heat=True):
    rates = tuple(TYPICAL[: model.RATES].tolist())
    own = MotorHeat(rates=rates, offset_k=(1, 2, 3), centre_k=(0.1,) * 3, noise_k=(0.2,) * 3)
    three = (1.0, 1.0, 1.0)
    return Calibration(
        window_s=5.0, maisd_limit_k=three, deviation_limit_k=three,
        heat=FleetHeat(scale=1.5, duty=(25.0, 160.0, 0.02, 0.1)) if with_heat else None,
        motor=tuple(
            MotorCalibration(
                node=n, gain=three, offset_k=(n, 0, 0), longest_hold_s=three,
                largest_step_k=three, heat=own if with_heat else None,
            )
            for n in NODES
        ),
    )  # fmt: skip


def test_what_was_learnt_is_stored_whole_and_edits_are_refused(tmp_path):
    path = tmp_path / "cells.toml"
    path.write_text(to_toml(cells()))
    back = calibration.load(path, NODES, 5.0)
    known, want = back.known((3, 1)), cells().known((3, 1))
    np.testing.assert_allclose(known.parameters, want.parameters, rtol=1e-5)
    np.testing.assert_allclose(known.duty, want.duty)
    assert (known.scale, known.centre.shape) == (1.5, (2, 3))
    assert known.own_k == OWN_K, "a file from before it was measured"
    measured = cells()
    fleet = measured.heat.model_copy(update={"own_k": 0.16})
    path.write_text(to_toml(measured.model_copy(update={"heat": fleet})))
    assert calibration.load(path, NODES, 5.0).known(NODES).own_k == 0.16
    found = {"inflation": 1.25, "covered": (0.9, 0.75), "lag_one": -0.1, "false_share": 0.01}
    motor = tuple(m.model_copy(update={"heat": m.heat.model_copy(update=found)})
                  if m.node == 3 else m for m in measured.motor)  # fmt: skip
    path.write_text(to_toml(measured.model_copy(update={"motor": motor})))
    coverage = calibration.load(path, NODES, 5.0).known((3, 1)).coverage
    assert coverage.inflation.tolist() == [1.25, 1.0]
    np.testing.assert_array_equal(coverage.covered, [(0.9, 0.75), (np.nan, np.nan)])
    assert coverage.unexplained.tolist() == [True, False]
    assert coverage.false_share.tolist() == [0.01, 0.0]
    path.write_text(to_toml(cells()))
    path.write_text(path.read_text().replace("scale = 1.5", "scale = 1.6"))
    with pytest.raises(ConfigError, match="checksum"):
        calibration.load(path, NODES, 5.0)
    path.write_text(to_toml(cells(with_heat=False)))
    without = calibration.load(path, NODES, 5.0)
    assert without.known(NODES) is None
    with pytest.raises(ConfigError, match="method"):
        TemperatureMonitor(3, 100 * MS, 5.0, without, NODES, model=True)


def test_the_learner_finds_motors_of_another_size(tmp_path):
    """Rates four times the typical ones, a hundredth of the current: two logs with holes."""
    own = TYPICAL.copy()
    own[: model.RATES] *= 4.0
    own[model.A] *= 100.0
    learner = Learner(NODES, 5.0)
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        n = 900
        square = np.repeat(rng.uniform(0.0, 250.0, n // 60), 60)
        speed = np.repeat(rng.uniform(50.0, 350.0, n // 90), 90)
        inputs = Inputs(np.tile(square[:, None], 3), speed, np.full(n, 15.0), np.arange(n), 1.0)
        truth = predict(np.tile(own, (3, 1)), inputs, np.tile([30.0, 25.0, 25.0], (3, 1)))
        readings = truth + rng.normal(0.0, 0.05, truth.shape)
        learner.begin()
        for k in range(n):
            hole = np.full(3, np.nan)
            known = hole if k in (100, 101) else np.full(3, square[k])
            learner.seconds[-1].append(
                Sample(readings[k], known, np.full(3, speed[k]), np.full(3, 15.0))
            )
    known = learner._known()
    assert known is not None
    got, want = known.parameters.mean(axis=0), own
    for rate in (model.A, model.K_W):
        assert got[rate] == pytest.approx(want[rate], rel=0.15)
    np.testing.assert_allclose(known.noise, 0.05, rtol=0.4)
    assert known.duty[1] == pytest.approx(125.0, rel=0.2)
    learner.seconds = [log[:100] for log in learner.seconds]
    assert learner._known() is None, "too short"
