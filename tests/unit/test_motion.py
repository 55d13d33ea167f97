"""The load observer takes over where currents come too slowly, without a bump."""

import math

import numpy as np
import pytest
from _traction_core import lib

from gateway.core.channel import RPM
from gateway.core.codes import Flag, Health, Reason
from gateway.settings.config import BENCH_MOTOR
from tests.columns import told_of
from tests.estimates import DriveEstimate, estimates_of
from tests.motions import Drives
from tests.reference import plausibility as reference
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


@pytest.mark.parametrize(
    "w_e", [1.5 * LIMIT_W_E, 3.0 * LIMIT_W_E, -3.0 * LIMIT_W_E, 880.0, 1950.0, -2200.0]
)
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
    return Drives(drives)


def tick(motion, *rows, flux=1.0):
    """Readings: drive, stamp, speed, torque."""
    motion.came.tick(rows)
    motion.estimates["flux_ratio"] = flux
    lib.follow_readings(motion.pointer)


def merged(motion, estimates, speeds, sampled=True):
    """What the filters estimate, and what becomes of it."""
    made = motion.estimates
    for k, e in enumerate(estimates):
        numbers = (e.speed_rad_s, e.load_nm, e.load_sigma_nm, e.nis)
        made["health"][k] = e.health
        for name, x in zip(
            ("speed_rad_s", "load_nm", "load_sigma_nm", "nis"), numbers, strict=True
        ):
            made[name][k] = math.nan if x is None else x
    motion.status["speed_rad_s"] = [math.nan if w is None else w for w in speeds]
    motion.status["sample_fresh"] = sampled
    lib.select_sources(motion.pointer, 0)
    return estimates_of(told_of(made))


def test_a_new_source_counts_at_once():
    """A wheel that grips turns slowly again: the load of its slide must not linger."""
    motion, given = side(), []
    for k in range(200):
        w_m = (1.1 if k < 100 else 0.9) * LIMIT_W_E / 4.0
        # One torque with no acceleration but the step's: the observer must not see one.
        tick(motion, (0, k * 10 * MS, LIMIT_W_E / 4.0, 6.0))
        filtered = DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)
        (estimate,) = merged(motion, [filtered], [w_m])
        assert motion.motions["aliasing"][0] == (k < 100)
        given.append(estimate.load_nm)
    assert given[99] == pytest.approx(6.0, abs=0.05)
    assert given[100:] == [19.0] * 100


def test_hysteresis_at_the_limit():
    motion = side()
    seen = []
    for share in (0.99, 1.01, 0.97, 0.94, 0.99, 1.01):
        w_m = share * LIMIT_W_E / 4.0
        merged(motion, [DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)], [w_m])
        seen.append(motion.motions["aliasing"].item(0))
    assert seen == [False, True, True, False, False, True]


def test_without_a_motion_the_noise_of_the_filters_speed_changes_no_source():
    """Noise of 4 % and a mean that is 3 % below, then 9 % above the limit, then 9 % below it."""
    motion, seen, rng = side(), [], np.random.default_rng(3)
    for share in [0.97] * 100 + [1.09] * 100 + [0.91] * 100:
        w_m = share * (1.0 + rng.uniform(-0.04, 0.04)) * LIMIT_W_E / 4.0
        merged(motion, [DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)], [None])
        seen.append(motion.motions["aliasing"].item(0))
    assert not any(seen[:100])
    assert all(seen[120:200])
    assert not any(seen[220:])
    merged(motion, [DriveEstimate(Health.CONVERGING, 2.0 * LIMIT_W_E)], [None])
    assert motion.motions["aliasing"].item(0), "no mean of a speed that is not found yet"


def test_a_drive_that_crawls_has_the_load_of_its_motion_and_without_one_that_of_its_filter():
    """Below 30 rad/s electrical, with 5 % of hysteresis; forwards and backwards."""
    for way in (1.0, -1.0):
        motion, seen = side(), []
        for k in range(60):
            tick(motion, (0, k * 10 * MS, way * 7.0, 20.0))
        for w_e in (30.0, 29.9, 31.0, 31.5, 31.6, 30.0, 0.0):
            w_m = way * w_e / 4.0
            (estimate,) = merged(
                motion, [DriveEstimate(Health.CONVERGING, w_m, 19.0, 0.5, 2.0)], [w_m]
            )
            seen.append(estimate.health is Health.TRACKING)
        assert seen == [False, True, True, False, False, False, True]
        (estimate,) = merged(motion, [DriveEstimate(Health.TRACKING, 0.0, 19.0, 0.5, 2.0)], [None])
        assert estimate.load_nm == pytest.approx(19.0, abs=1.0)


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
    assert motion.motions["aliasing"].item(0)
    assert not motion.motions["aliasing"].item(1)
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


def test_a_rotor_that_turns_and_is_not_found_is_implausible():
    motion, w_m = side(), 0.5 * LIMIT_W_E / 4.0
    seen = []
    for _ in range(110):
        (state,) = merged(motion, [DriveEstimate(Health.CONVERGING)], [w_m])
        seen.append(state.health)
    assert seen == [Health.CONVERGING] * 100 + [Health.INPUT_INVALID] * 10


def test_without_a_reading_a_fast_drive_is_unknown():
    motion, w_m = side(), 2.0 * LIMIT_W_E / 4.0
    (state,) = merged(motion, [DriveEstimate(Health.TRACKING, w_m, 19.0, 0.5, 2.0)], [w_m])
    assert state == DriveEstimate(Health.UNKNOWN, reason=Reason.NOT_AVAILABLE)


def held(motion, ticks, speeds, sent=(5.0, 20.0), known=True):
    """Ticks of `Motion` that is always the same of drive 0; how many make it unknown."""
    for k in range(1, ticks + 1):
        now = k * 10 * MS
        torque = sent[1] + (k if sent[1] < 0.0 else 0)
        motion.came.tick([(0, now, sent[0], torque, math.nan)])
        measured = [sent[0], *(w[min(k, len(w) - 1)] for w in speeds)]
        motion.status["speed_rad_s"] = measured
        motion.estimates["health"] = Health.TRACKING if known else Health.CONVERGING
        motion.estimates["load_nm"] = 20.0
        lib.check_plausibility(motion.pointer, now)
        if math.isnan(motion.status["speed_rad_s"][0]):
            return k
    return None


def test_motion_that_stands_still_beside_a_moving_rotor_is_not_known():
    """From 100 ms on, after three readings; a torque that changes is a Motion that lives."""
    for speed, torque, known, wanted in (
        (5.0, 20.0, True, None), (30.0, 20.0, True, 14), (30.0, -90.0, True, None),
        (30.0, 20.0, False, None),
    ):  # fmt: skip
        motion = side()
        motion.bank.filters["x"][:, 2] = 4.0 * speed
        assert held(motion, 40, [], (5.0, torque), known) == wanted


def test_motion_stands_still_while_all_others_move():
    nan = math.nan
    moving, steady, unknown = list(range(40)), [7.0] * 40, [nan, nan, *range(38)]
    gone, limit = [7.0, 7.0, 7.0, nan], [7.0] * 10 + [8.0] * 30
    for others, wanted in (([moving], 14), ([moving, moving], 14), ([moving, steady], None),
                           ([moving, unknown], 14), ([unknown], None),
                           ([moving, gone], 14), ([gone], None), ([limit], None)):  # fmt: skip
        motion = side(1 + len(others))
        assert held(motion, 40, others, known=False) == wanted


@pytest.mark.parametrize("stands", range(4))
@pytest.mark.parametrize("stays", range(4))
def test_motion_that_stands_is_compared_with_every_other_drive_since_it_stands(stands, stays):
    """Speeds but one move by 3 rad/s a tick; the Motion that stands does so from 60 ms on."""
    motion, room = side(4), np.full(32, math.nan)
    motion.record["others"] = room.ctypes.data + room.nbytes // 2  # before them nothing is known
    for k in range(1, 40):
        speeds = [7.0 if drive == stays else 3.0 * k + drive for drive in range(4)]
        sent = [(speed, 20.0 + k) for speed in speeds]
        sent[stands] = min(k, 6), 20.0
        now, motion.status["speed_rad_s"] = k * 10 * MS, speeds
        motion.came.tick([(drive, now, *one, math.nan) for drive, one in enumerate(sent)])
        lib.check_plausibility(motion.pointer, now)
        unknown = [math.isnan(speed) for speed in motion.status["speed_rad_s"]]
        assert unknown == [drive == stands == stays and k >= 19 for drive in range(4)], k


def test_of_every_drive_the_speeds_are_kept_that_were_measured_when_its_motion_changed():
    """In as many rows as there are drives, and nothing behind them is written."""
    motion, rng, n = side(4), np.random.default_rng(9), 4
    others, taken = np.full(n * n + 1, -7.0), np.full(n + 1, 9, np.uint8)
    motion.record["others"], motion.record["taken"] = others.ctypes.data, taken.ctypes.data
    sent, then = np.zeros(n), np.zeros((n, n))
    for k in range(1, 300):
        speeds, now = rng.uniform(0.0, 50.0, n), k * 10 * MS
        changed = rng.random(n) < (1.0 if k == 1 else 0.3)
        sent[changed], then[changed] = k, speeds
        motion.status["speed_rad_s"] = speeds
        motion.came.tick([(drive, now, sent[drive], 20.0, math.nan) for drive in range(n)])
        lib.check_plausibility(motion.pointer, now)
        np.testing.assert_array_equal(others[:-1].reshape(n, n)[motion.noted], then)
        assert (others[-1], taken[-1]) == (-7.0, 9)


def test_a_command_that_stays_and_a_speed_that_has_come_to_that_of_motion_are_no_contradiction():
    """A filter that has just started may have been wrong when Motion last changed."""
    motion = side()
    motion.came.drives["command"] = 20.0
    assert held(motion, 40, [], known=False) is None
    motion.bank.filters["x"][:, 2] = 4.0 * 20.0
    assert held(motion, 1, [], (5.5, 20.0)) is None
    motion.bank.filters["x"][:, 2] = 4.0 * 5.5
    motion.checks["changed_ns"] -= 200 * MS
    assert held(motion, 40, [], (5.5, 20.0)) is None


@pytest.mark.parametrize(("sigma_rad_s", "wanted"), [(0.49, 14), (0.51, None)])
def test_a_speed_within_four_standard_deviations_of_motion_does_not_contradict_it(
    sigma_rad_s, wanted
):
    motion = side()
    motion.bank.filters["x"][:, 2] = 4.0 * 7.0
    motion.bank.filters["P"][:, 2, 2] = (4.0 * sigma_rad_s) ** 2
    assert held(motion, 40, [], (5.0, 20.0)) == wanted


@pytest.mark.parametrize(("ahead_ns", "starts", "again"), [
    (20 * MS + 1, False, 1), (20 * MS, True, 1), (1, True, 1), (0, True, 0),
])  # fmt: skip
def test_a_filter_starts_anew_from_20_ms_before_the_end_of_implausible_input(
    ahead_ns, starts, again
):
    motion, now = side(), 1000 * MS
    motion.checks["restart"], motion.checks["implausible_until_ns"] = 1, now + ahead_ns
    motion.bank.filters["active"], motion.bank.filters["v_q_bias"] = 1, 0.5
    motion.estimates["flux_ratio"] = 1.1
    motion.came.tick([])
    lib.check_plausibility(motion.pointer, now)
    assert motion.checks["restart"].item() == again
    assert math.isnan(motion.estimates["flux_ratio"].item()) == starts
    assert (motion.bank.filters["v_q_bias"].item() == 0.0) == starts
    assert (motion.bank.filters["active"].item() == 0) == starts


def test_a_current_of_which_one_half_stays_is_no_repeat():
    motion = side()
    motion.status["speed_rad_s"] = 20.0
    for k in range(1, 30):
        rows = [(0, (0.0, 0.0), (5.0, j), 16, 0) for j in (k, -k)]
        motion.came.tick(samples=rows)
        lib.check_plausibility(motion.pointer, k * 10 * MS)
        assert motion.checks["repeats"].item() == motion.checks["block_repeats"].item() == 0
    assert motion.checks["implausible_until_ns"].item() == 0


@pytest.mark.parametrize(
    ("variance", "r_scale", "equal", "implausible"),
    [(1e-4, 1.0, 1, True), (1e-2, 1.0, 1, False), (1e-4, 100.0, 1, False), (1e-2, 1.0, 2, True),
     (1.0, 400.0, 2, False), (1.0, 400.0, 3, True)],
)  # fmt: skip
def test_noise_can_make_two_samples_equal(variance, r_scale, equal, implausible):
    """CAN FD, 20 A that move by 0.51 A from one sample to the next; the noise is 0.1 A.

    The third equal sample should have moved by 1.54 A: more than 5 % of 25 A, whatever the noise.
    """
    motion = side()
    motion.status["speed_rad_s"] = 51.2
    motion.checks["least_change_a"], motion.checks["current_var"] = 0.5, variance
    motion.bank.filters["r_scale"] = r_scale
    turns = [*range(10), *[9] * equal, *range(10 + equal, 20)]
    angles = [4.0 * 51.2 * 125e-6 * k for k in turns]
    rows = [(0, (0.0, 0.0), (20.0 * math.cos(x), 20.0 * math.sin(x)), 1, 0) for x in angles]
    motion.came.tick(samples=rows)
    lib.check_plausibility(motion.pointer, 10 * MS)
    assert (motion.checks["implausible_until_ns"].item() > 0) == implausible


def test_at_high_speed_the_largest_current_of_a_tick_explains_the_torque():
    """Wherever in the tick it is, and with what motor data are off by; two equal samples repeat."""
    for ampere, excess in ((8.0, 0), (2.0, 1)):
        motion, now = side(), 10 * MS
        torque = motion.checks["torque_per_a"].item() * 8.0
        torque += reference.TORQUE_OFF * motion.checks["rated_nm"].item()
        motion.came.drives["sample_ns"] = now
        rows = [(0, (0.0, 0.0), (x, 0.0), 16, 0) for x in (ampere, 1.0, 1.0)]
        motion.came.tick([(0, now, 300.0, torque, math.nan)], rows)
        lib.check_plausibility(motion.pointer, now)
        assert motion.checks["excess_misfits"].item() == excess
    motion = side()
    motion.came.tick(samples=rows[:1] * 2)
    lib.check_plausibility(motion.pointer, now)
    assert motion.checks["repeats"].item() == 1


@pytest.mark.parametrize(("speed", "implausible"), [(20.0, True), (0.0, False)])
def test_a_current_that_stays_while_its_rotor_turns_is_implausible(speed, implausible):
    motion = side()
    for k in range(1, 30):
        motion.status["speed_rad_s"] = speed
        motion.came.tick(samples=[(0, (0.0, 0.0), (5.0, 1.0), 16, 0)] * 5)
        lib.check_plausibility(motion.pointer, k * 10 * MS)
    assert (motion.checks["implausible_until_ns"].item() > 290 * MS) == implausible


def test_an_angle_that_is_off_for_a_minute_is_the_new_one():
    """A rotor that stands, with torque: the current is along q at angle 0, and then it is not."""
    motion = side()
    current = 20.0 / motion.checks["torque_per_a"].item()
    motion.estimates["health"], motion.estimates["load_nm"] = Health.TRACKING, 20.0
    now, implausible = 0, []
    for angle, ticks, step in ((0.0, 30, 10), (0.7, 10, 10), (0.7, 40, 1000), (0.7, 50, 1000)):
        for _ in range(ticks):
            now += step * MS
            motion.came.drives["sample_ns"] = now
            sample = (0, (0.0, 0.0), (0.0, current), 16, 0)
            motion.came.tick([(0, now, 0.0, 20.0, angle)], [sample])
            motion.status["speed_rad_s"] = 0.0
            lib.check_plausibility(motion.pointer, now)
        implausible.append(now < motion.checks["implausible_until_ns"].item())
    assert implausible == [False, True, True, False]
    assert motion.checks["learnt"].item() == 20


def test_on_its_limits_motion_is_in_order():
    """Speeds that differ by 5 rad/s, ten samples a revolution, five cycles to a reading."""
    motion = side(2)
    motion.record["n"], motion.motions["aliasing"] = 1, (0, 7)
    for w_m, estimated in ((0.0, 5.0), (motion.record["max_w_e"].item() / 4.0,) * 2):
        for _ in range(10):
            given = [DriveEstimate(Health.TRACKING, estimated, 19.0, 0.5, 2.0)] * 2
            assert merged(motion, given, [w_m] * 2)[0].health is Health.TRACKING
        assert motion.motions["aliasing"].tolist() == [0, 7], (
            "of a drive that there is not: as it was"
        )
    for k in (*range(10), 14):
        tick(motion, (0, k * 10 * MS, w_m, 20.0))
    assert motion.motions["readings"].item(0) == 10


def test_at_a_crawl_a_motion_that_repeats_for_more_than_two_and_a_half_cycles_accuses_nobody():
    motion, until = side(), []
    motion.motions["crawls"] = 1
    for now in (10 * MS, 20 * MS, 35 * MS, 45 * MS):
        motion.came.tick([(0, now, 0.5, 20.0, math.nan)])
        lib.check_plausibility(motion.pointer, now)
        until.append(motion.rotors["unreliable_until_ns"].item())
    assert max(until[:3]) < 0, "never yet"
    assert until[3] == 60 * MS, "for a cycle and a half from now on"


def test_on_their_limits_command_and_load_fit():
    motion, seen = side(), []
    rated = motion.checks["rated_nm"].item()
    motion.motions["started"], motion.motions["readings"] = 1, 5
    motion.estimates["health"], motion.status["speed_rad_s"] = Health.TRACKING, 0.0
    motion.came.drives["command"] = 0.0
    for now, command, age_ns, load in (
        (10 * MS, 0.0, 0, 0.25), (200 * MS, 0.15, 200 * MS, 0.25), (210 * MS, 0.16, 100 * MS, 0.25),
        (220 * MS, 0.16, 100 * MS + 1, 0.26),
    ):  # fmt: skip
        motion.came.tick([(0, now, 0.0, 20.0, math.nan)])
        motion.came.drives["command"] = command * rated
        motion.came.drives["command_ns"], motion.estimates["load_nm"] = now - age_ns, load * rated
        lib.check_plausibility(motion.pointer, now)
        seen.append([motion.checks[name].item() for name in ("motion_misfits", "load_misfits")])
    assert seen == [[0, 0]] * 3 + [[1, 1]]


@pytest.mark.parametrize(("nis", "counted"), [(9.0, 1), (9.1, 0)])
def test_a_load_that_its_observer_still_follows_contradicts_no_filter(nis, counted):
    """A wheel that grips again carries three times its load at once: the filter is right first."""
    motion = side()
    motion.motions["started"], motion.motions["readings"] = 1, 5
    motion.motions["observer"]["nis"] = nis
    motion.estimates["health"], motion.status["speed_rad_s"] = Health.TRACKING, 0.0
    motion.came.tick([(0, 10 * MS, 0.0, 0.0, math.nan)])
    motion.estimates["load_nm"] = motion.checks["rated_nm"].item()
    lib.check_plausibility(motion.pointer, 10 * MS)
    assert motion.checks["load_misfits"].item() == counted


@pytest.mark.parametrize(("ampere", "judged"), [(3.0, 1), (2.99, 0)])
def test_with_fifteen_percent_of_rated_a_current_says_something(ampere, judged):
    """Of a torque that is not sent, and of its angle to one that is."""
    for torque, counted in ((0.0, "torque_misfits"), (30.0, "learnt")):
        motion = side()
        motion.checks["rated_a"], motion.checks["torque_per_a"] = 20.0, 10.0
        motion.checks["rated_nm"], motion.estimates["health"] = 30.0, Health.TRACKING
        motion.came.drives["sample_ns"], motion.status["speed_rad_s"] = MS, 0.0
        motion.came.tick([(0, MS, 0.0, torque, 0.0)], [(0, (0.0, 0.0), (0.0, ampere), 16, 0)])
        lib.check_plausibility(motion.pointer, MS)
        assert motion.checks[counted].item() == judged
