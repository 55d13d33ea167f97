"""The load observer takes over where currents come too slowly, without a bump."""

import itertools
import math

import numpy as np
import pytest

from estimators import current_calibration
from gateway._motion_kernels import merge_motion, observe_motion
from gateway.config import BENCH_MOTOR, Estimator
from gateway.health import Flag, Health, Reason
from gateway.inputs import inputs
from gateway.motion import MotionSide, Timebase
from gateway.slow import RPM, readings
from gateway.tracks import told
from tests.estimates import DriveEstimate, estimates_of
from tests.sender import MS, Sender, SteadyDrive, codec_for
from tests.unit.test_core import Bench, gateway

CODEC = codec_for()
LIMIT_W_E = 2.0 * math.pi / (10.0 * 2e-3)


def bench(w_e, load=20.0):
    return Bench(gateway(), [SteadyDrive(CODEC, n, w_e, load, theta=n) for n in (1, 2, 3)])


def with_motion(w_e, torque=20.0):
    senders = [Sender(CODEC, f"Drive{n}_Motion") for n in (1, 2, 3)]

    def add(frames, now):
        rpm = w_e / 4.0 / RPM
        return [*frames, *(s.frame(now, Speed=rpm, ElectricalAngle=1.0, Torque=torque)
                           for s in senders)]  # fmt: skip

    return add


@pytest.mark.parametrize("w_e", [1.5 * LIMIT_W_E, 3.0 * LIMIT_W_E, -3.0 * LIMIT_W_E, 880.0])
def test_beyond_ten_samples_per_revolution_the_observer_answers(w_e):
    view = bench(w_e).run(80, with_motion(w_e))
    assert [d.adhesion for d in view.drives] == [Flag.GOOD] * 3
    assert [d.health for d in view.drives] == [Health.TRACKING] * 3
    assert view.drives[0].load_nm == pytest.approx(20.0, abs=0.2)
    assert view.drives[0].speed_rad_s == pytest.approx(w_e / 4.0, abs=0.1)


def test_without_motion_it_is_said_that_it_is_missing():
    view = bench(1.5 * LIMIT_W_E).run(80)
    assert [d.adhesion for d in view.drives] == [Flag.UNKNOWN] * 3
    assert [d.health for d in view.drives] == [Health.UNKNOWN] * 3
    assert view.adhesion_reason is Reason.NOT_AVAILABLE
    assert view.estimator is Flag.UNKNOWN


def test_motion_that_stops_makes_unknown_within_its_age_limit():
    bus = bench(1.5 * LIMIT_W_E)
    assert bus.run(80, with_motion(1.5 * LIMIT_W_E)).drives[0].adhesion is Flag.GOOD
    view = bus.run(6)
    assert [d.adhesion for d in view.drives] == [Flag.UNKNOWN] * 3


def side(drives=1):
    times = Timebase(2e-3, 10 * MS, 0.5 * RPM)
    return MotionSide([BENCH_MOTOR] * drives, Estimator(), times, 10 * MS)


def tick(motion, *rows, flux=1.0):
    """Readings: drive, stamp, speed, torque."""
    given = readings(8)
    for k, row in enumerate(rows):
        for column, value in zip(given, (*row, math.nan), strict=True):
            column[k] = value
    motion.take(given, len(rows), np.full(len(motion.memory.load), flux))


def merged(motion, estimates, speeds, sampled=True):
    """What the bank told, and what becomes of it."""
    n = len(estimates)
    said = told(n)
    for k, e in enumerate(estimates):
        numbers = (e.speed_rad_s, e.load_nm, e.load_sigma_nm, e.nis)
        said.health[k] = e.health
        said.speed[k], said.load[k], said.sigma[k], said.nis[k] = (
            math.nan if x is None else x for x in numbers
        )
    given = inputs(n)
    given.speed[:] = [math.nan if w is None else w for w in speeds]
    given.fresh[:] = sampled
    motion.settle(given, current_calibration.start(n), np.zeros(n, dtype=np.int64), 0, said)
    return estimates_of(said)


def test_the_change_of_source_is_no_bump_and_fades():
    """The filter says 19, the observer 20; in between nothing jumps."""
    motion, given = side(), []
    for k in range(300):
        w_m = (0.9 if k < 100 else 1.1) * LIMIT_W_E / 4.0
        # One torque with no acceleration but the step's: the observer must not see one.
        tick(motion, (0, k * 10 * MS, LIMIT_W_E / 4.0, 20.0))
        filtered = DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)
        (estimate,) = merged(motion, [filtered], [w_m])
        assert motion.memory.beyond[0] == (k >= 100)
        given.append(estimate.load_nm)
    steps = [abs(b - a) for a, b in itertools.pairwise(given)]
    assert given[99] == 19.0
    assert max(steps) < 0.05
    assert given[-1] == pytest.approx(20.0, abs=0.05)


def test_hysteresis_at_the_limit():
    motion = side()
    seen = []
    for share in (0.99, 1.01, 0.97, 0.94, 0.99, 1.01):
        w_m = share * LIMIT_W_E / 4.0
        merged(motion, [DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)], [w_m])
        seen.append(motion.memory.beyond.item(0))
    assert seen == [False, True, True, False, False, True]


def test_input_that_cannot_be_believed_stays_so():
    motion = side()
    w_m = 2.0 * LIMIT_W_E / 4.0
    for k in range(10):
        tick(motion, (0, k * 10 * MS, w_m, 20.0))
        wrong = DriveEstimate(Health.INPUT_INVALID)
        assert merged(motion, [wrong], [w_m]) == [wrong]


def test_motion_alone_goes_on_as_a_prediction():
    """Currents that do not come any more show no longer whether it is plausible."""
    motion, seen = side(), []
    w_m = 2.0 * LIMIT_W_E / 4.0
    for k in range(12):
        tick(motion, (0, k * 10 * MS, w_m, 20.0))
        (state,) = merged(motion, [DriveEstimate(Health.CONVERGING)], [w_m], sampled=k != 10)
        seen.append(state.health)
    assert seen[9:] == [Health.TRACKING, Health.PREDICTING, Health.TRACKING]


def test_a_hole_starts_the_observer_anew():
    motion = side()
    w_m = 2.0 * LIMIT_W_E / 4.0
    state = DriveEstimate(Health.CONVERGING)
    for k in (*range(10), *range(40, 44)):
        tick(motion, (0, k * 10 * MS, w_m, 20.0))
        (state,) = merged(motion, [DriveEstimate(Health.CONVERGING)], [w_m])
    assert state.health is Health.CONVERGING


def test_where_one_drive_needs_the_observer_all_use_it_that_can():
    """Filter and observer follow a load step differently: compared, one would look lost."""
    motion = side(3)
    slow, fast = 0.9 * LIMIT_W_E / 4.0, 1.1 * LIMIT_W_E / 4.0
    filtered = [DriveEstimate(Health.TRACKING, slow, 18.0, 0.5, 2.0)] * 3
    for k in range(10):
        now = k * 10 * MS
        tick(motion, (0, now, fast, 20.0), (1, now, slow, 20.0))
        given = merged(motion, filtered, [fast, slow, None])
    assert motion.memory.beyond.item(0)
    assert not motion.memory.beyond.item(1)
    friction = BENCH_MOTOR.B * fast
    assert given[0].load_nm == pytest.approx(20.0 - friction, abs=0.1)
    assert given[1].load_sigma_nm == given[0].load_sigma_nm != filtered[1].load_sigma_nm
    assert given[2] == filtered[2], "without Motion the filter's"


def test_the_torque_sent_is_the_data_sheets_and_the_load_the_magnets():
    motion, w_m = side(), 2.0 * LIMIT_W_E / 4.0
    for k in range(50):
        tick(motion, (0, k * 10 * MS, w_m, 20.0), flux=1.15)
        (estimate,) = merged(motion, [DriveEstimate(Health.UNKNOWN)], [w_m])
    assert estimate.load_nm == pytest.approx(1.15 * 20.0 - BENCH_MOTOR.B * w_m, abs=0.1)


def test_compiled_equals_uncompiled(monkeypatch):
    """Any readings, any estimates, holes in both."""
    quick = walk(side(3))
    monkeypatch.setattr("gateway.motion.observe_motion", observe_motion.py_func)
    monkeypatch.setattr("gateway.motion.merge_motion", merge_motion.py_func)
    assert walk(side(3)) == quick
    healths = {estimate.health for tick in quick for estimate in tick}
    assert healths == set(Health) - {Health.PREDICTING, Health.DIVERGED}


def walk(motion):
    rng = np.random.default_rng(5)
    given = []
    for k in range(600):
        # Slow, fast, and what the currents say of it: mostly the same.
        w = (0.5 + 0.8 * (k // 100 % 2)) * LIMIT_W_E / 4.0
        rows = [(d, k * 10 * MS, w + rng.normal(), 20.0) for d in range(3) if rng.random() < 0.9]
        tick(motion, *(() if k % 150 < 20 else rows), flux=(math.nan, 1.1)[k % 2])
        health = rng.choice([Health.TRACKING] * 8 + [Health.CONVERGING, Health.INPUT_INVALID])
        off = 50.0 if 300 < k < 320 else 0.0
        given.append(
            merged(
                motion,
                [DriveEstimate(Health(health), w + off, 19.0, 0.5, 2.0)] * 3,
                [w if rng.random() < 0.95 else None for _ in range(3)],
            )
        )
    return given
