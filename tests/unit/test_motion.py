"""The load observer takes over where currents come too slowly, without a bump."""

import itertools
import math

import pytest

from gateway.bank import DriveEstimate
from gateway.config import BENCH_MOTOR, Estimator
from gateway.health import Flag, Health, Reason
from gateway.inbox import Motion
from gateway.motion import MotionSide, Timebase
from gateway.slow import RPM
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


def tick(motion, *readings, flux=1.0):
    motion.take(readings, lambda _: flux)


def merged(motion, estimates, speeds):
    motion.note_speeds(estimates, speeds)
    each = zip(estimates, speeds, strict=True)
    return [motion.merge(k, estimate, w) for k, (estimate, w) in enumerate(each)]


def test_the_change_of_source_is_no_bump_and_fades():
    """The filter says 19, the observer 20; in between nothing jumps."""
    motion, given = side(), []
    for k in range(300):
        w_m = (0.9 if k < 100 else 1.1) * LIMIT_W_E / 4.0
        # One torque with no acceleration but the step's: the observer must not see one.
        tick(motion, Motion(0, k * 10 * MS, LIMIT_W_E / 4.0, 20.0))
        filtered = DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)
        (estimate,) = merged(motion, [filtered], [w_m])
        assert motion.beyond(0) is (k >= 100)
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
        seen.append(motion.beyond(0))
    assert seen == [False, True, True, False, False, True]


def test_input_that_cannot_be_believed_stays_so():
    motion = side()
    w_m = 2.0 * LIMIT_W_E / 4.0
    for k in range(10):
        tick(motion, Motion(0, k * 10 * MS, w_m, 20.0))
        wrong = DriveEstimate(Health.INPUT_INVALID)
        assert merged(motion, [wrong], [w_m])[0] is wrong


def test_a_hole_starts_the_observer_anew():
    motion = side()
    w_m = 2.0 * LIMIT_W_E / 4.0
    state = DriveEstimate(Health.CONVERGING)
    for k in (*range(10), *range(40, 44)):
        tick(motion, Motion(0, k * 10 * MS, w_m, 20.0))
        (state,) = merged(motion, [DriveEstimate(Health.CONVERGING)], [w_m])
    assert state.health is Health.CONVERGING


def test_where_one_drive_needs_the_observer_all_use_it_that_can():
    """Filter and observer follow a load step differently: compared, one would look lost."""
    motion = side(3)
    slow, fast = 0.9 * LIMIT_W_E / 4.0, 1.1 * LIMIT_W_E / 4.0
    filtered = [DriveEstimate(Health.TRACKING, slow, 18.0, 0.5, 2.0)] * 3
    for k in range(10):
        now = k * 10 * MS
        tick(motion, Motion(0, now, fast, 20.0), Motion(1, now, slow, 20.0))
        given = merged(motion, filtered, [fast, slow, None])
    assert motion.beyond(0)
    assert not motion.beyond(1)
    friction = BENCH_MOTOR.B * fast
    assert given[0].load_nm == pytest.approx(20.0 - friction, abs=0.1)
    assert given[1].load_sigma_nm == given[0].load_sigma_nm != filtered[1].load_sigma_nm
    assert given[2] is filtered[2], "without Motion the filter's"


def test_the_torque_sent_is_the_data_sheets_and_the_load_the_magnets():
    motion, w_m = side(), 2.0 * LIMIT_W_E / 4.0
    for k in range(50):
        tick(motion, Motion(0, k * 10 * MS, w_m, 20.0), flux=1.15)
        (estimate,) = merged(motion, [DriveEstimate(Health.UNKNOWN)], [w_m])
    assert estimate.load_nm == pytest.approx(1.15 * 20.0 - BENCH_MOTOR.B * w_m, abs=0.1)
