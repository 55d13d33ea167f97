"""`motion.c`, `plausibility.c`, `current_plausibility.c` against Python: anything drives can do."""

import copy
import math

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import pointer
from gateway.core.codes import Health
from gateway.settings.config import BENCH_MOTOR
from tests import columns
from tests.motions import TIMES, Drives
from tests.reference import motion as reference
from tests.reference import plausibility
from tests.same import near_numbers, same_numbers
from tests.sender import MS
from tests.stations import MotionMonitor
from tests.thorough import some

TICK = 10 * MS
LATE_NS = (0,) * 30 + (300_000, 3_000_000)
"""Of samples, in turn."""
FIELDS = {
    "current": "vector", "samples": "samples", "repeats": "equal", "repeated_s": "equal_s",
    "block_repeats": "block", "implausible_until_ns": "until_ns", "restart": "restart",
    "base": "base", "learnt": "learnt", "deviation": "deviation", "angle_misfits": "off",
    "torque_misfits": "torque_off", "excess_misfits": "excess", "load_misfits": "load_off",
    "motion_misfits": "motion_held",
    "angle_fitted_ns": "off_ns", "angle_ns": "angle_ns", "speed": "speed", "torque": "torque",
    "changed_ns": "changed_ns", "command": "command",
}  # fmt: skip
"""Field of `struct plausibility`: of the reference."""
MOTION = {
    "started": "begun", "reading_ns": "last_ns", "readings": "readings", "aliasing": "beyond",
    "crawls": "crawls",
    "disagree_ticks": "apart",
    "unlocked_ns": "unlocked_ns", "implausible": "wrong", "smooth_speed": "mean",
}  # fmt: skip
"""The same of `struct motion`."""
FAULTS = (
    "none", "none", "none", "none", "held", "late", "block", "swapped", "scaled", "weak", "angle",
    "any_angle", "no_angle", "no_torque", "still", "load", "speed", "no_samples", "no_motion",
    "few", "huge", "zero", "early",
)  # fmt: skip
HEALTHS = [Health.TRACKING] * 12 + [Health.CONVERGING] * 2 + [Health.INPUT_INVALID, Health.UNKNOWN]


class Plain:
    """The reference, with what it works on: copies of the same."""

    def __init__(self, drives):
        n = len(drives.motions)
        self.drives, self.memory = drives, reference.memory(n)
        own, checks = drives.record[0], drives.checks
        mechanics, p = drives.motions["mechanics"], drives.motions["pole_pairs"].astype(float)
        rows = np.stack([mechanics[name] for name in ("J", "B", "speed_var", "load_rate")], 1)
        self.limits = reference.Limits(
            rows, p, int(own["motion_cycle_ns"]), int(own["tick_ns"]), own["max_w_e"],
            reference.HYSTERESIS, reference.MOST_MISSING, reference.SETTLED_READINGS,
            own["turning_w_e"], reference.LOCKED_NS, reference.SPEED_TOLERANCE,
            reference.SPEED_TOLERANCE_RAD_S, reference.TICKS, own["crawl_w_e"],
        )  # fmt: skip
        self.doubt_ns = drives.rotors["unreliable_until_ns"].copy()
        self.check = plausibility.start(n, self.doubt_ns)
        self.check_limits = plausibility.PlausibilityLimits(
            p, checks["torque_per_a"], checks["rated_a"], checks["rated_nm"],
            checks["least_change_a"], checks["current_var"], own["period_s"], own["dt"],
            int(own["motion_cycle_ns"]), reference.SETTLED_READINGS,
        )  # fmt: skip

    def take(self, count, samples, now):
        """What `observe_load` will do, on copies."""
        drives = self.drives
        self.estimates, self.status = drives.estimates.copy(), drives.status.copy()
        self.filters, self.sensors = drives.bank.filters.copy(), drives.bank.sensors.copy()
        told, given = columns.told_of(self.estimates), columns.inputs_of(self.status)
        came, readings = drives.came, drives.came.readings

        def open_phase(k, w_e):
            record = pointer("struct current_calibration", self.sensors) + k
            return bool(lib.is_single_axis_current(record, w_e))

        reference.observe_motion(readings, count, told.flux, self.memory, self.limits)
        plausibility.check_values(
            came.samples.first(samples), came.drives, readings, count, given.speed,
            columns.slow_of(came.drives), now, drives.bank.chords, self.filters, told,
            self.memory, self.check, self.check_limits,
        )  # fmt: skip
        self.memory.away[:] = drives.rotors["away"]
        reference.merge_motion(
            given, open_phase, self.check.until_ns, now, told, self.memory, self.limits
        )

    def assert_same(self):
        """What C has left is what the reference has."""
        drives = self.drives
        pairs = [(drives.checks[a], getattr(self.check, b), a) for a, b in FIELDS.items()]
        pairs += [(drives.motions[a], getattr(self.memory, b), a) for a, b in MOTION.items()]
        names = drives.motions["observer"].dtype.names
        pairs += [
            (drives.motions["observer"][name], self.memory.observer[:, j], name)
            for j, name in enumerate(names)
        ]
        pairs += [(drives.others[drives.noted], self.check.others, "others")]
        pairs += [(drives.rotors["unreliable_until_ns"], self.doubt_ns, "doubt")]
        for mine, plain in (
            (drives.estimates, self.estimates), (drives.status, self.status),
            (drives.bank.filters, self.filters),
        ):  # fmt: skip
            pairs += [(mine[name], plain[name], name) for name in mine.dtype.names]
        for mine, plain, name in pairs:
            near_numbers(mine, plain, name)
        flags = drives.bank.sensors["single_axis"], self.sensors["single_axis"]
        same_numbers(*flags)


class Train:
    """Drives that turn, and what goes wrong with each, for a while."""

    def __init__(self, seed, n, fd=False):
        times = TIMES._replace(sample_s=125e-6) if fd else TIMES
        self.rng, self.drives, self.now = np.random.default_rng(seed), Drives(n, times), TICK
        self.rows, self.fd = (8, True) if fd else (5, False)
        self.n, self.left, self.theta, self.load = n, 0, np.zeros(n), np.full(n, 20.0)
        self.last, self.met = np.zeros((n, 8, 2)), set()

    def draw(self):
        """The next situation."""
        rng, n = self.rng, self.n
        self.left = int(rng.choice([1, 3, 10, 40, 120]))
        level = rng.choice([0.0, 20.0, 60.0, 150.0, 200.0, 200.0, 300.0, 310.0, 400.0, -150.0])
        self.w_e = level * rng.choice([1.0, 1.0, 1.0, 1.01, 0.7, 0.0], n)
        self.fault = rng.choice(FAULTS, n)
        if rng.random() < 0.3:
            self.fault[:] = "none"
        self.load = rng.choice([20.0, 12.0, 1.0, -15.0]) * rng.choice([1.0, 1.0, 0.5], n)
        self.health = rng.choice(HEALTHS, n)
        self.flux = rng.choice([np.nan, 1.0, 1.1], n)
        self.fresh = rng.random(n) < 0.9
        self.drives.bank.sensors["single_axis"] = rng.random(n) < 0.05
        self.drives.came.drives["command"] = rng.choice([20.0, 19.0, 8.0, np.nan], n)
        self.drives.bank.chords["ready"] = rng.random(n) < 0.5
        self.drives.bank.chords["w"] = self.w_e
        self.drives.rotors["away"] = np.arange(n) == self.left % 11
        if rng.random() < 0.03:
            self.now += rng.choice([100, 1000, 61_000]) * MS

    def sample(self, k, age_s, fault):
        """Current of drive k, so long ago."""
        per_a = self.drives.checks["torque_per_a"][k]
        i_q = self.load[k] / per_a * (1.0 if np.isnan(self.flux[k]) else 1.0 / self.flux[k])
        angle = self.theta[k] - self.w_e[k] * age_s + 0.5 * math.pi + 0.3 * (fault == "swapped")
        size = {"scaled": 1.8, "weak": 0.02, "huge": 1e200, "zero": 0.0}.get(fault, 1.0)
        value = size * i_q * np.array([math.cos(angle), math.sin(angle)])
        value += self.rng.normal(0.0, 0.05, 2) * (fault != "zero")
        if fault == "held" or (fault == "late" and self.rng.random() < 0.1):
            value = self.last[k, -1].copy()
        if fault == "block":
            value = self.last[k, 0].copy()
        self.last[k] = np.roll(self.last[k], -1, axis=0)
        self.last[k, -1] = value
        return value

    def readings(self, k, fault):
        """Motion of drive k in this tick."""
        rng = self.rng
        t_ns = self.now - int(rng.choice([0, 0, 0, 300_000, 1_000_000]))
        if fault == "early":
            t_ns -= 6 * MS
        angle = self.theta[k] + {"angle": 0.7, "any_angle": rng.uniform(0.0, 6.0)}.get(fault, 0.0)
        angle += self.w_e[k] * (t_ns - self.now + 500_000) * 1e-9
        torque = self.load[k] + rng.normal(0.0, 0.02)
        speed = self.w_e[k] / self.drives.motions["pole_pairs"][k] + rng.normal(0.0, 0.01)
        if fault == "still":
            old = self.drives.checks[k]
            speed, torque = old["speed"], old["torque"]
        if fault == "no_torque":
            torque *= 0.02
        row = (k, t_ns, speed, torque, math.nan if fault == "no_angle" else angle)
        return {"no_motion": [], "few": [row] * (rng.random() < 0.1)}.get(fault, [row])

    def tick(self):
        """One tick's rows and estimates."""
        rng, drives = self.rng, self.drives
        if not self.left:
            self.draw()
        self.left -= 1
        motions, samples = [], []
        self.theta += self.w_e * TICK * 1e-9
        for k in range(self.n):
            fault = self.fault[k]
            steps = 1 if self.fd else 16
            for j in range(self.rows if fault != "no_samples" else 0):
                age_s = (self.rows - 1 - j) * steps * 125e-6
                gap = 72 if self.fd and not j else 0
                samples.append((k, (0.0, 0.0), self.sample(k, age_s, fault), steps, gap))
            motions += self.readings(k, fault)
            drives.came.drives["sample_ns"][k] = self.now - 500_000
            drives.came.drives["clock"]["late_ns"][k] = LATE_NS[
                (self.now // TICK + k) % len(LATE_NS)
            ]
            drives.came.drives["clock"]["usual_ns"][k] = LATE_NS[self.now // TICK % len(LATE_NS)]
        samples.sort(key=lambda row: -(row[0] % 2))
        p = drives.motions["pole_pairs"]
        drives.came.drives["command_ns"] = self.now - rng.choice([50, 250]) * MS
        drives.status["speed_rad_s"] = np.where(rng.random(self.n) < 0.95, self.w_e / p, np.nan)
        drives.status["sample_fresh"] = self.fresh
        made = drives.estimates
        made["health"], made["flux_ratio"] = self.health, self.flux
        off = np.where(self.fault == "speed", 20.0, 0.0)
        made["speed_rad_s"], made["load_nm"] = self.w_e / p + off, self.load
        made["load_nm"][self.fault == "load"] *= -0.5
        made["load_sigma_nm"], made["nis"] = 0.5, 2.0
        unknown = np.isin(self.health, [Health.UNKNOWN, Health.CONVERGING]) & (rng.random() < 0.5)
        made["speed_rad_s"][unknown] = np.nan
        made["load_nm"][rng.random(self.n) < 0.01] = np.nan
        drives.bank.filters["x"][:, 2], drives.bank.filters["x"][:, 3] = self.w_e, self.theta
        drives.bank.filters["active"], drives.bank.filters["v_q_bias"] = 1, 0.5
        drives.bank.filters["r_scale"] = rng.choice([1.0, 5.0, 400.0], self.n)
        drives.came.tick(motions, samples)
        return len(motions), len(samples)


@pytest.mark.parametrize(("seed", "n"), some([(0, 1), (0, 2), (0, 4)], [(1, 1), (1, 2), (1, 4)]))
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_any_course_of_a_train(seed, n):
    train = Train(seed, n, fd=seed == 1)
    plain = Plain(train.drives)
    names = ("restart", "learnt", "angle_misfits", "torque_misfits", "repeats")
    met: dict[str, set[int]] = {name: set() for name in names}
    for _ in range(1500):
        plain.take(*train.tick(), train.now)
        train.drives.observe(train.now)
        plain.assert_same()
        train.now += TICK
        for name, values in met.items():
            values |= set(train.drives.checks[name].tolist())
    assert all(len(values) > 1 for values in met.values()), met


def test_constants_are_those_of_motor_and_messages():
    drives = Drives(2, step_a=0.01)
    own = drives.record[0]
    assert own["max_w_e"] == pytest.approx(2.0 * math.pi / 0.02)
    assert own["motion_cycle_ns"] == TIMES.period_ns == 10 * MS
    assert own["dt"] == 125e-6
    m, check = BENCH_MOTOR, drives.checks[1]
    assert check["torque_per_a"] == m.k_p * m.pole_pairs * m.psi_pm
    assert check["rated_a"], check["rated_nm"] == (m.I_rated, m.T_rated)
    assert check["least_change_a"] == max(0.1, 0.01 * m.I_rated)
    assert Drives(1, step_a=1.0).checks["least_change_a"] == 10.0


def numbers(drives):
    """All that a tick changes."""
    bank = drives.bank
    return repr([table.tolist() for table in (drives.motions, drives.checks, bank.estimates)])


def test_a_copy_goes_on_by_itself():
    train = Train(3, 2)
    for _ in range(100):
        train.tick()
        train.drives.observe(train.now)
        train.now += TICK
    train.tick()
    drives = train.drives
    twin = copy.deepcopy(drives, {id(drives.came): drives.came})
    before = numbers(drives)
    twin.observe(train.now)
    assert numbers(drives) == before != numbers(twin)
    drives.observe(train.now)
    assert numbers(drives) == numbers(twin)
    assert isinstance(twin, MotionMonitor)
    assert twin.pointer != drives.pointer


def test_an_open_phase_is_invalid_input():
    drives = Drives(1)
    drives.bank.sensors["single_axis"] = 1
    drives.status["speed_rad_s"] = 0.0
    drives.estimates["health"], drives.estimates["load_nm"] = Health.TRACKING, 20.0
    drives.observe(TICK)
    assert drives.motions["implausible"].tolist() == [1]
    assert drives.estimates["health"].tolist() == [Health.INPUT_INVALID]
    assert np.isnan(drives.estimates["load_nm"]).all()
