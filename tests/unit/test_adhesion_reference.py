"""`loads.c` and `adhesion.c` against Python: any loads, commands and flags, tick by tick."""

import copy
import math

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import DRIVE_STATUS, pointer
from estimators.detect import DETECTORS
from estimators.detect.switching import Switching
from gateway.core import flags, inputs, receiving
from gateway.core.adhesion import BASE_NM, AdhesionMonitor
from gateway.core.codes import NEVER, Flag, Health
from gateway.core.flags import FlagKind, Timing
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Adhesion
from tests import columns
from tests.judged_loads import detect
from tests.reference import adhesion as reference
from tests.same import same_numbers
from tests.thorough import some

N = 3
MS = 1_000_000
TICK = 10 * MS
ADHESION = Timing(40 * MS, 20 * MS, 60 * MS)
RULES = flags.rules([ADHESION] * 5, ADHESION, 0.7, 0.2, TICK)
OTHER = BENCH_MOTOR.model_copy(update={"T_rated": 2.0 * BENCH_MOTOR.T_rated})


def train_that_drives(rng, n, ticks):
    """What is estimated and commanded: losses of one and of all, silence, new commands."""
    command, share, before = np.full(n, 20.0), np.ones(n), np.full(n, 20.0)
    lost = np.ones(n)
    lost[n // 2] = 0.1
    for tick in range(ticks):
        if tick % 10 == 0:
            before = command.copy()
            if rng.random() < 0.1:
                command = np.full(n, rng.choice([20.0, 15.0, 0.5, -12.0, 2.5]))
                command *= rng.choice([1.0, 1.0, 0.5], n)
        if rng.random() < 0.03:
            share = rng.choice([np.ones(n), np.full(n, 0.1), np.full(n, 0.78), lost])
        health = np.where(rng.random(n) < 0.02, Health.CONVERGING, Health.TRACKING)
        load = command * share + rng.normal(0.0, rng.choice([0.1, 1.5]), n)
        speed = 25.0 + rng.normal(0.0, 0.1, n)
        speed[rng.random(n) < 0.01] = math.nan
        stamp = tick if tick % 300 > 200 else tick - tick % 10
        sent = stamp * TICK, rng.random(n) < 0.9
        told = command.copy()
        if tick % 100 > 60:
            # One that reads far more than its drive carries.
            told[0] *= 10.0
        yield health, load, speed, told, before, sent, rng.random(n) < 0.98, 1.0


def anything(rng, n, ticks):
    """Numbers that do not go together, some of them none."""
    numbers = [0.0, -0.0, 1.0, -1.0, 20.0, -20.0, 1e308, math.nan, math.inf, -math.inf]
    for tick in range(ticks):
        load, speed = rng.normal(0.0, 20.0, n), rng.normal(5.0, 20.0, n)
        command, before = rng.normal(5.0, 12.0, (2, n))
        for column in (load, speed, before):
            hit = rng.random(n) < 0.1
            column[hit] = rng.choice(numbers, n)[hit]
        command[rng.random(n) < 0.1] = 0.0
        command[rng.random(n) < 0.1] = math.nan
        health = rng.choice([Health.TRACKING] * 4 + [Health.CONVERGING], n)
        sent = tick * TICK - int(rng.integers(0, 30)) * MS, rng.random(n) < 0.8
        fresh = (rng.random(n) < 0.8) & ~np.isnan(command)
        yield health, load, speed, command, before, sent, fresh, rng.choice([1.0, 0.5])


def on_limits(rng, n, ticks):
    """Few numbers: loads that are equal, commands that just coast, speeds that go and come back."""
    rated = BENCH_MOTOR.T_rated
    for tick in range(ticks):
        load, speed = (
            rated * rng.choice([0.0, 0.25, 0.5], n),
            rng.choice([0.0, 24.0, 25.0, 26.0], n),
        )
        command, before = rated * rng.choice([0.0, 0.05, 0.05, 0.25, 0.5], (2, n))
        health = np.where(rng.random(n) < 0.9, Health.TRACKING, Health.CONVERGING)
        steady, fresh = rng.random((2, n)) < 0.9
        yield health, load, speed, command, before, ((tick - 1) * TICK, steady), fresh, 1.0


def validity(commanded, speed):
    """`input_status`: commands that are known, and measured speeds."""
    made = inputs.statuses(len(speed))
    made["command_valid"], made["speed_rad_s"] = commanded, speed
    return made


class Both:
    """The station and its reference on the same ticks."""

    def __init__(self, motors, tick_ns=TICK, detector="vb"):
        self.n = len(motors)
        self.core = AdhesionMonitor(Adhesion(detector=detector), motors, RULES, tick_ns)
        spread = Adhesion().spread_nm / BASE_NM
        model = Switching(self.n, tick_ns) if detector == "switching" else None
        self.plain = reference.Adhesion(motors, RULES, tick_ns, spread, model)
        self.status = np.zeros(self.n, DRIVE_STATUS)
        self.drives = receiving.drive_inputs(self.n)
        self.slow = columns.slow_of(self.drives)

    def run(self, given):
        """Ticks in which all drives operate: (opinion, flags and common mode) of each."""
        for tick, one in enumerate(given):
            opinion = self.tick(one, tick * TICK)
            yield opinion, self.decide(opinion, tick * TICK)

    def tick(self, given, now, operating=True, emergency_ns=-1):
        told = columns.told(self.n)
        health, load, speed, command, before, (sent, steady), fresh, measured = given
        told.health[:], told.load[:], told.speed[:] = health, load, speed
        told.sigma[:], told.nis[:] = 0.1 * (1 + np.arange(self.n)), 1.0
        told.estimates["by_observer"] = now // (9 * TICK) % 2
        mine = self.slow
        mine.command[:], mine.before[:], mine.command_ns[:] = command, before, sent
        mine.steady[:], mine.operating[:] = steady, operating
        mine.emergency_ns[:] = emergency_ns
        come = validity(fresh, speed * measured)
        flag = self.status["flag"][:, FlagKind.ADHESION]
        again = copied(told)
        opinion = detect(self.core, told.estimates, come, self.drives, self.status, now)
        if self.plain is None:
            return opinion
        kept = flag["state"].astype(np.int64), flag["since_ns"].copy()
        self.plain.tick(again, mine, come["speed_rad_s"], fresh, *kept, now)
        self.same(told, again)
        return opinion

    def same(self, told, again):
        core, plain = self.core, self.plain
        same_numbers(told.estimates, again.estimates)
        if plain.model is not None:
            same_numbers(core.switching.loads, plain.model.loads)
            same_numbers(core.loads["regripped_s"], plain.held_s)
            same_numbers(core.record["common_missing_s"], plain.together.since_s)
        for mine, wanted in (
            (core.rotors, plain.rotors), (core.rotor_inputs, plain.inputs),
            (core.responses, plain.responses), (core.ratios, plain.differences.drives),
            (core.response_ratios, plain.own.drives),
            (core.record["spread"], plain.differences.all),
            (core.record["response_spread"], plain.own.all),
            (core.record["common_mode"], plain.flag),
            (core.normalised, plain.normalised), (core.sigma, plain.sigma),
            (core.known, plain.known), (core.loss_probability, plain.lost),
            (core.loss_known, plain.lost_known), (core.loads["severe_loss"], plain.severe),
            (core.loads["command_ratio"], plain.ratio),
            (core.loads["unknown_s"], plain.unknown_s),
            (core.loads["known_since_ns"], plain.known_ns),
            (core.record["flagged_ns"], plain.any_flagged_ns),
        ):  # fmt: skip
            same_numbers(mine, wanted)

    def decide(self, opinion, now):
        """The flags by the opinion alone."""
        lost = opinion.known & (opinion.lost > 0.7)
        wanted = np.where(lost, Flag.BAD, np.where(opinion.known, Flag.GOOD, Flag.UNKNOWN))
        flag = self.status["flag"][:, FlagKind.ADHESION]
        flag["since_ns"][flag["state"] != wanted] = now
        flag["state"] = wanted
        return tuple(wanted.tolist()), self.core.record["common_mode"]["state"].item()


def copied(told):
    made = columns.told(len(told.health))
    made.estimates[:] = told.estimates
    return made


@pytest.mark.parametrize("detector", ["vb", "switching"])
@pytest.mark.parametrize("seed", some([0, 1], [2, 3]))
def test_a_train_that_drives(seed, detector):
    motors = [BENCH_MOTOR] * N
    rng, both, met = np.random.default_rng(seed), Both(motors, detector=detector), set()
    first = both.core.record["spread"]["spread"].item()
    for tick, given in enumerate(train_that_drives(rng, N, 800)):
        opinion = both.tick(given, tick * TICK, rng.random() < 0.99)
        met |= {*both.decide(opinion, tick * TICK)}
    assert set(Flag) <= met, "common mode"
    assert (Flag.GOOD, Flag.BAD, Flag.GOOD) in met
    assert both.core.record["spread"]["spread"].item() != first, "the spread is learnt"


def test_a_long_train_that_drives():
    """64 drives, of two kinds: flags as the reference decides them, of which one is lost."""
    rng, both, met = np.random.default_rng(3), Both([BENCH_MOTOR, OTHER] * 32), set()
    for _, (states, _) in both.run(train_that_drives(rng, 64, 300)):
        met.add(tuple(k for k, state in enumerate(states) if state == Flag.BAD))
    assert (32,) in met


@pytest.mark.parametrize("detector", ["vb", "switching"])
@pytest.mark.parametrize(("n", "ticks"), [(1, 1500), (2, 1500), (5, 1500), (16, 300), (65, 150)])
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_anything(n, ticks, detector):
    rng, both = np.random.default_rng(n), Both(([BENCH_MOTOR, OTHER] * n)[:n], detector=detector)
    for tick, given in enumerate(anything(rng, n, ticks)):
        if tick % 7 == 0:
            until_ns = (tick + rng.integers(0, 20, n)) * TICK
            for rotors in (both.core.rotors, both.plain.rotors):
                rotors["unreliable_until_ns"] = until_ns
        ago = rng.choice([1, 2, 3, 29, 30, 31, 10**6], n)
        emergency = np.maximum(-1, (tick - ago) * TICK)
        opinion = both.tick(given, tick * TICK, rng.random(n) < 0.9, emergency)
        if rng.random() < 0.7:
            both.decide(opinion, tick * TICK)


@pytest.mark.parametrize(("n", "detector"), [(1, "vb"), (2, "vb"), (3, "vb"), (3, "switching")])
def test_numbers_on_limits(n, detector):
    """At first no flag changes: no command follows one."""
    rng, both = np.random.default_rng(n), Both([BENCH_MOTOR] * n, detector=detector)
    for tick, given in enumerate(on_limits(rng, n, 400), 300):
        opinion = both.tick(given, tick * TICK)
        if tick > 500:
            both.decide(opinion, tick * TICK)


def with_given_verdicts():
    """Both, and their models, which never move by themselves."""
    both = Both([BENCH_MOTOR] * N, detector="switching")
    models = both.core.switching, both.plain.model
    for model in models:
        model.record["ticks"], model.record["every"] = 1, 2**30
    return both, models


def test_any_verdict_of_the_model_with_a_memory():
    """Numbers on the limits, too."""
    rng, met = np.random.default_rng(4), set()
    both, models = with_given_verdicts()
    for tick, given in enumerate(train_that_drives(rng, N, 600)):
        if tick % 3 == 0:
            lost = rng.choice([0.0, 0.0, 0.1, 0.3, 0.5, 0.7, 0.99, 1.0], N)
            adhering = np.where(rng.random(N) < 0.3, 0.5, 1.0 - lost)
            demand = rng.choice([0.05, 0.1, 0.2, 0.7])
        for model in models:
            model.lost[:], model.adhering[:], model.record["demand"] = lost, adhering, demand
        opinion = both.tick(given, tick * TICK)
        met |= set(both.decide(opinion, tick * TICK)[0])
    assert met == set(Flag)


def test_wheels_that_grip_again_and_drives_that_are_known_again():
    """Not known for 0.09 to 0.2 s, or 12 % faster for 0.1 to 0.3 s; loads like no others'."""
    rng, cleared = np.random.default_rng(8), 0
    both, models = with_given_verdicts()
    gap, slip = np.zeros((2, N), dtype=int)
    for tick, given in enumerate(train_that_drives(rng, N, 5000)):
        if tick % 5 == 0:
            lost = rng.choice([0.0, 0.05, 0.1, 0.2, 0.5, 0.99, 1.0], N)
            adhering = np.minimum(rng.choice([0.0, 0.4, 0.5, 0.9, 1.0], N), 1.0 - lost)
            demand = rng.choice([0.05, 0.1, 0.3, 0.6, 0.6, 0.9, -0.3])
        for model in models:
            model.lost[:], model.adhering[:], model.record["demand"] = lost, adhering, demand
        gap = np.where((gap == 0) & (rng.random(N) < 0.02), rng.integers(9, 20, N), gap)
        gap = np.maximum(gap - 1, 0)
        slip = np.where((slip == 0) & (rng.random(N) < 0.01), rng.integers(10, 30, N), slip)
        slip = np.maximum(slip - 1, 0)
        speed = given[2] * np.where(slip > 0, 1.12, 1.0)
        health = np.where(gap > 0, Health.CONVERGING, given[0])
        flag = both.status["flag"][:, FlagKind.ADHESION]["state"].copy()
        opinion = both.tick((health, given[1], speed, *given[3:]), tick * TICK)
        unlike = (adhering < 0.5) & (lost <= 0.1) & (flag == Flag.BAD)
        cleared += int((unlike & opinion.known & (opinion.lost == 0.0)).sum())
        both.decide(opinion, tick * TICK)
    assert cleared > 5


def test_one_drive_alone_is_lost_by_its_command():
    """Of each seed: it is compared with nobody."""
    met = set()
    for seed in range(6):
        rng, both = np.random.default_rng(seed), Both([BENCH_MOTOR], detector="switching")
        met |= {states for _, (states, _) in both.run(train_that_drives(rng, 1, 200))}
    assert (Flag.BAD,) in met


def test_the_common_load_is_smoothed_no_further_than_to_itself():
    """Of ticks longer than its time constant."""
    both = Both([BENCH_MOTOR] * N, 500 * MS)
    for tick, given in enumerate(train_that_drives(np.random.default_rng(1), N, 20)):
        both.tick(given, tick * 500 * MS)
    known = both.core.record["common_smoothed"].item()
    assert known == both.core.record["common"].item()


@pytest.mark.parametrize(
    ("load_nm", "slows", "known"),
    [
        (0.5, 0.0, True),
        (0.1 * BENCH_MOTOR.T_rated, 0.0, True),
        (3.2, 0.0, True),
        (4.0, 0.0, False),
        (0.5, 0.002, False),
    ],
)
def test_who_carries_what_nobody_asked_for_or_slows_down_does_not_only_roll(load_nm, slows, known):
    """3.2 Nm is above a tenth of rated torque: these drives are compared, they do not roll."""
    both, numbers = Both([BENCH_MOTOR] * N, detector="switching"), np.full(N, 0.0)
    health = np.full(N, Health.TRACKING)
    given = (
        (health, numbers + load_nm, numbers + 80.0 * (1.0 - slows) ** tick, numbers, numbers,
         (tick * TICK, True), numbers == 0.0, 1.0)
        for tick in range(100)
    )  # fmt: skip
    *_, (opinion, _) = both.run(given)
    assert (opinion.known == known).all()


@pytest.mark.parametrize(("others", "left", "slips", "cleared"), [
    (0.5, 0.0, 0.0, True),
    (0.5, 0.02, 0.0, True),
    (0.5, 0.0, 0.05, False),  # it does not turn with the others
    (0.0, 0.0, 0.0, True),  # nobody is asked: the train rolls
])  # fmt: skip
def test_a_drive_that_is_cut_out_is_accused_until_its_command_comes(others, left, slips, cleared):
    """Its load goes 0.1 s before; the train, at 0.6 of rated torque until then, is driven on."""
    both, rated = Both([BENCH_MOTOR] * N, detector="switching"), BENCH_MOTOR.T_rated
    health, first, met = np.full(N, Health.TRACKING), np.arange(N) == 0, []
    for tick in range(150):
        asked = np.full(N, 0.6 if tick < 100 else others)
        command = np.where(first & (tick >= 100), left, asked) * rated
        load = np.where(first & (tick >= 90), left, asked) * rated
        speed = 50.0 * (1.0 + slips * first * (tick >= 90))
        sent = tick // 10 * 10 * TICK
        given = health, load, speed, command, command, (sent, True), command >= 0.0, 1.0
        opinion = both.tick(given, tick * TICK)
        both.decide(opinion, tick * TICK)
        met.append((opinion.known[0].item(), round(opinion.lost[0].item(), 2)))
    assert met[80] == (True, 0.0)
    assert met[95] == (True, 1.0)
    assert (met[-1] == (True, 0.0)) == cleared


@pytest.mark.parametrize(("once", "forgets"), [(0.75, True), (2.0, False)])
def test_a_demand_that_no_drive_was_ever_asked_for_is_forgotten(once, forgets):
    """The load of a wheel that gripped, 2, is taken for the demand; all carry the 0.6 that they are
    asked for, but were asked for `once`. The noise hides now and then that they answer."""
    rng, both = np.random.default_rng(4), Both([BENCH_MOTOR] * N, detector="switching")
    both.plain, model, numbers = None, both.core.switching, np.ones(N)
    for tick in range(150):
        if tick == 20:
            model.hypotheses["m"], model.hypotheses["s"], model.hypotheses["v_mm"] = 2.0, 0.0, 1e-4
            model.drives["adhering"], model.drives["lost"] = 0.0, 1.0
            model.drives["c"], model.drives["v_c"] = 0.3, 1e-4
        load = BENCH_MOTOR.T_rated * (0.6 + rng.normal(0.0, 0.03, N))
        command = BENCH_MOTOR.T_rated * (once if tick < 10 else 0.6) * numbers
        sent = tick // 10 * 10 * TICK, True
        given = np.full(N, Health.TRACKING), load, 50.0 * numbers, command, command, sent
        both.tick((*given, numbers > 0.0, 1.0), tick * TICK)
        if tick == 30:
            assert both.core.record["common"] > 1.5
    assert (both.core.record["common"] < 0.7) == forgets
    assert (model.adhering > 0.9).all() == forgets


@pytest.mark.parametrize(("demand", "valid", "answers"), [
    (0.8101, True, True), (-0.8101, True, True), (0.8099, True, False), (0.8101, False, False),
])  # fmt: skip
def test_on_the_limit_a_demand_is_more_than_a_drive_was_ever_asked_for(demand, valid, answers):
    """0.6 of rated torque, 0.15 of that and 0.12; no drive carries what it is asked for."""
    both, rated = Both([BENCH_MOTOR] * N, detector="switching"), BENCH_MOTOR.T_rated
    both.plain, numbers = None, np.ones(N)
    for tick in range(3):
        both.core.record["common"] = demand
        health, command = np.full(N, Health.TRACKING), 0.6 * rated * numbers
        both.tick((health, 0.3 * rated * numbers, 50.0 * numbers, command, command, (0, True),
                   np.full(N, valid or tick < 2), 1.0), tick * TICK)  # fmt: skip
    assert (both.core.switching.loads["answers"] == answers).all()


@pytest.mark.parametrize("detector", ["vb", "switching"])
def test_a_copy_goes_on_alone(detector):
    rng, both = np.random.default_rng(7), Both([BENCH_MOTOR] * N, detector=detector)
    given = list(train_that_drives(rng, N, 60))
    for tick, one in enumerate(given[:30]):
        both.tick(one, tick * TICK)
    twin, kept = copy.deepcopy(both.core), both.core.record.copy()
    for tick, one in enumerate(given[30:], 30):
        both.tick(one, tick * TICK)
    assert twin.record["learn_ns"] == kept["learn_ns"] < both.core.record["learn_ns"]
    both.core, done = twin, both.core
    both.plain = None
    for tick, one in enumerate(given[30:], 30):
        both.tick(one, tick * TICK)
    for name in ("rotors", "responses", "ratios", "loads", "loss_probability"):
        same_numbers(getattr(twin, name), getattr(done, name))
    twin.rotors["uncertain"][:] = 7
    assert twin.rotors["uncertain"].tolist() == [7] * N
    assert 7 not in done.rotors["uncertain"]


@pytest.mark.parametrize("name", DETECTORS)
def test_a_detector_of_ones_own_stops_between_the_stages(name):
    """With the default one outside of the core: the same to the last bit."""
    motors = [BENCH_MOTOR] * N
    inside = AdhesionMonitor(Adhesion(detector="vb"), motors, RULES, TICK)
    outside = AdhesionMonitor(Adhesion(detector=name), motors, RULES, TICK)
    outside.in_core = False
    drives, status = receiving.drive_inputs(N), np.zeros(N, DRIVE_STATUS)
    mine, met = columns.slow_of(drives), set()
    for tick, given in enumerate(train_that_drives(np.random.default_rng(2), N, 300)):
        health, load, speed, command, before, (sent, steady), fresh, _ = given
        mine.command[:], mine.before[:], mine.command_ns[:] = command, before, sent
        mine.steady[:], mine.operating[:] = steady, True
        said = []
        for side in (inside, outside):
            told = columns.told(N)
            told.health[:], told.load[:], told.speed[:] = health, load, speed
            come = validity(fresh, speed)
            opinion = detect(side, told.estimates, come, drives, status, tick * TICK)
            said.append((opinion.lost.tolist(), opinion.known.tolist(), opinion.common))
        assert said[0] == said[1] or name != "vb"
        met |= {p > 0.7 for p in said[1][0]}
    assert met == {False, True}


def test_what_nothing_is_known_of_is_not_judged():
    both = Both([BENCH_MOTOR] * N)
    told = columns.told(N)
    opinion = detect(both.core, told.estimates, inputs.statuses(N), both.drives, both.status, 0)
    assert not opinion.known.any()
    assert opinion.common == 0.0
    assert (both.core.rotors["unreliable_until_ns"] == NEVER).all()
    assert math.isnan(both.core.record["common_smoothed"].item())


def test_rotors_have_the_ratings_of_their_motors():
    """What is written by the plausibility check and read here is one and the same."""
    core = AdhesionMonitor(Adhesion(), [BENCH_MOTOR, OTHER, BENCH_MOTOR], RULES, TICK)
    assert core.rotors["motor"].tolist() == [0, 1, 0]
    rated = BENCH_MOTOR.T_rated
    assert core.rotors["rated_nm"].tolist() == [rated, 2.0 * rated, rated]
    core.rotors["unreliable_until_ns"][1], core.rotors["uncertain"][2] = 7, 1
    assert core.rotors["unreliable_until_ns"].tolist() == [NEVER, 7, NEVER]
    assert core.rotors["uncertain"].tolist() == [0, 0, 1]
    assert round(lib.LEARN_PERIOD_S * 1000) == reference.LEARN_NS // MS


def test_a_monitor_that_is_reset_knows_nothing():
    core = AdhesionMonitor(Adhesion(), [BENCH_MOTOR] * N, RULES, TICK)
    known_nothing = [getattr(core, name) for name in (
        "responses", "known", "loss_known", "may_learn", "normalised", "sigma", "loss_probability",
    )]  # fmt: skip
    for array in known_nothing:
        array.view(np.uint8)[:] = 1
    lib.adhesion_reset(pointer("struct adhesion", core.record), 0.1)
    assert not any(array.view(np.uint8).any() for array in known_nothing)


def by_memory(asked=False, bad=False, other=(), **given):
    """Two drives judged by `switching`: the first has no command, the second adheres.

    given: fields of the first drive, record__field. bad: its flag; asked: the second has a command.
    other: arrays of the second, as functions of the monitor, and their values.
    """
    core = AdhesionMonitor(Adhesion(detector="switching"), [BENCH_MOTOR] * 2, RULES, TICK)
    core.switching.adhering[:], core.switching.lost[:] = (0.05, 1.0), (0.95, 0.0)
    core.known[:] = core.loss_known[:] = core.record["comparable"] = 1
    core.rotors["creep"], core.rotors["learnt_s"], core.rotors["load"] = 0.0, 1.0, 0.0
    core.record["common"] = core.record["common_smoothed"] = 0.5
    for name, value in given.items():
        record, _, field = name.partition("__")
        getattr(core, record)[field][0] = value
    if asked:
        core.responses["usable"][1] = 1
        core.responses["command"][1] = core.responses["previous_command"][1] = 0.5
    for array, value in other:
        array(core)[1] = value
    status = np.zeros(2, DRIVE_STATUS)
    status["flag"][0, FlagKind.ADHESION]["state"] = Flag.BAD if bad else Flag.UNKNOWN
    lib.judge_by_memory(
        pointer("struct adhesion", core.record), pointer("struct drive_status", status), 0
    )
    return core


@pytest.mark.parametrize("creep", [0.03, -0.03, 0.0301])
def test_on_the_limit_a_wheel_that_is_asked_for_nothing_turns_with_the_others(creep):
    turning = {"rotors__speed": 50.0, "rotors__slow_speed": 50.0, "rotors__creep": creep}
    core = by_memory(responses__usable=1, **turning)
    assert core.loss_probability[0] == (0.0 if abs(creep) <= 0.03 else 0.95)


@pytest.mark.parametrize(("command", "before", "most", "rolls"), [
    (0.0999, 0.0999, 0.5, True),
    (0.0999, 0.0999, 0.4995, False),  # not less than a fifth
    (0.1, 0.1, 0.9, False),  # asked
    (0.05, 0.0, 0.9, False),  # perhaps it will be asked for 0.1
    (0.09, 0.09, 0.1, True),  # it has been asked for nothing all the time
    (0.09, 0.09, 0.1001, False),
])  # fmt: skip
def test_on_the_limit_a_drive_is_cut_out(command, before, most, rolls):
    given = {"command": command, "previous_command": before}
    given = {f"responses__{name}": value for name, value in given.items()}
    given |= {"loads__most_asked": most, "rotor_inputs__command_valid": 1}
    core = by_memory(asked=True, **given)
    assert (core.loss_probability[0] == 0.0) == rolls


OTHER_WHEEL = {
    "not known": [(lambda core: core.known, 0)],
    "lost": [(lambda core: core.switching.adhering, 0.4999)],
    "far": [(lambda core: core.rotors["far"], 1)],
    "away": [(lambda core: core.rotors["away"], 1)],
    "asked for nothing": [
        (lambda core: core.responses["command"], 0.0999),
        (lambda core: core.responses["previous_command"], 0.0999),
    ],
}


@pytest.mark.parametrize("other", OTHER_WHEEL.values(), ids=OTHER_WHEEL)
def test_a_drive_that_is_cut_out_rolls_along_with_one_that_adheres_under_load(other):
    given = {"rotor_inputs__command_valid": 1, "asked": True}
    assert by_memory(**given).loss_probability[0] == 0.0
    assert by_memory(**given, other=other).loss_probability[0] != 0.0


@pytest.mark.parametrize("load", [0.5, 0.4999])
def test_on_the_limit_a_wheel_that_has_gripped_carries_the_demand(load):
    core = by_memory(loads__load=load, loads__regripped_s=1.0, rotors__above=1)
    assert (core.loss_probability[0] == 0.0) == (load == 0.5)


@pytest.mark.parametrize("common", [0.2, -0.2, 0.1999])
def test_on_the_limit_of_a_small_load_a_comparison_accuses(common):
    assert by_memory(record__common_smoothed=common).loss_known[0] == (abs(common) >= 0.2)


def test_on_their_limits_gap_and_slip_belong_to_the_time_in_which_a_drive_is_held_back():
    left = [
        by_memory(loads__unknown_s=0.1).loads["regripped_s"][0],
        by_memory(loads__unknown_s=0.099).loads["regripped_s"][0],
        by_memory(loads__regripped_s=1.0, rotors__creep=0.05).loads["regripped_s"][0],
        by_memory(loads__regripped_s=1.0, rotors__creep=0.051).loads["regripped_s"][0],
        by_memory(loads__regripped_s=1.0, rotors__creep=-0.06, record__common=0.0).loads[
            "regripped_s"
        ][0],
    ]
    assert left == [2.0, 0.0, pytest.approx(0.99), 0.0, pytest.approx(0.99)]


@pytest.mark.parametrize("detector", ["vb", "switching"])
def test_what_lies_behind_the_drives_is_left_alone(detector):
    """Room for three, of which two are in use: the third one adheres, and nobody asks it."""
    core = AdhesionMonitor(Adhesion(detector=detector), [BENCH_MOTOR] * 3, RULES, TICK)
    core.record["n"] = 2
    if core.switching is not None:
        core.switching.record["n"] = 2
        core.switching.record["ticks"], core.switching.record["every"] = 1, 2
        core.switching.lost[:], core.switching.adhering[:] = (1.0, 1.0, 0.3), (0.0, 0.0, 1.0)
    third = {name: getattr(core, name)[2:].view(np.uint8) for name in (
        "rotors", "rotor_inputs", "responses", "response_ratios", "ratios", "observed", "loads",
        "normalised", "sigma", "known", "loss_probability", "loss_known", "may_learn",
    )}  # fmt: skip
    for array in third.values():
        array[:] = 3
    two = AdhesionMonitor(Adhesion(detector=detector), [BENCH_MOTOR] * 2, RULES, TICK)
    drives, told, status = receiving.drive_inputs(3), columns.told(3), np.zeros(3, DRIVE_STATUS)
    drives["command_steady"], core.rotors["load"][2] = [True, True, False], 9.0
    core.loads["flagged_ns"][2] = NEVER
    left_alone = {name: array.copy() for name, array in third.items()}
    told.health[:], told.speed[:], told.load[:] = Health.TRACKING, 25.0, (20.0, 10.0, 15.0)
    columns.slow_of(drives).command[:] = 20.0, 10.0, 40.0
    come, again = validity(np.ones(3, dtype=bool), told.speed), copied(told)
    detect(core, told.estimates, come, drives, status, 0)
    assert all((array == left_alone[name]).all() for name, array in third.items())
    if detector == "switching":
        assert core.loss_probability[:2].tolist() == [lib.UNDECIDED, lib.UNDECIDED]
        return
    detect(two, again.estimates[:2], come[:2], drives[:2], status[:2], 0)
    for name in third.keys() - {"rotors"}:
        same_numbers(getattr(core, name)[:2], getattr(two, name))


def test_a_train_rolls_whatever_lies_behind_its_drives():
    """Two drives that are asked for nothing, and room for a third that is."""
    core = AdhesionMonitor(Adhesion(detector="switching"), [BENCH_MOTOR] * 3, RULES, TICK)
    core.record["n"] = core.switching.record["n"] = 2
    core.responses["usable"][2], core.responses["command"][2] = 1, 1.0
    core.responses["previous_command"][2] = 1.0
    drives, told, status = receiving.drive_inputs(2), columns.told(2), np.zeros(2, DRIVE_STATUS)
    told.health[:], told.speed[:], told.load[:] = Health.TRACKING, 25.0, 0.0
    columns.slow_of(drives).command[:] = 0.0
    for tick in range(20):
        come = validity(np.ones(2, dtype=bool), told.speed)
        detect(core, told.estimates, come, drives, status, tick * TICK)
    assert core.loss_known[:2].tolist() == [1, 1]
    assert core.loss_probability[:2].tolist() == [0.0, 0.0]


def test_a_drive_that_is_cut_out_rolls_along_with_none_that_lies_behind_its_drives():
    """Of two drives the second one is lost; in the room behind them one adheres under load."""
    core = AdhesionMonitor(Adhesion(detector="switching"), [BENCH_MOTOR] * 3, RULES, TICK)
    core.record["n"] = core.switching.record["n"] = 2
    core.switching.adhering[:], core.switching.lost[:] = (0.0, 0.0, 1.0), (1.0, 1.0, 0.0)
    core.known[:] = core.responses["usable"][:] = core.rotor_inputs["command_valid"][:] = 1
    core.responses["command"], core.responses["previous_command"] = (0.0, 0.5, 0.5), (0.0, 0.5, 0.5)
    core.rotors["creep"] = core.rotors["load"] = 0.0
    status = np.zeros(2, DRIVE_STATUS)
    record = pointer("struct adhesion", core.record)
    lib.judge_by_memory(record, pointer("struct drive_status", status), 0)
    assert core.loss_probability[0] != 0.0
    core.record["n"] = core.switching.record["n"] = 3
    lib.judge_by_memory(record, pointer("struct drive_status", np.zeros(3, DRIVE_STATUS)), 0)
    assert core.loss_probability[0] == 0.0


def test_drives_that_gripped_are_a_measure_whatever_lies_behind_them():
    """Two of two drives gripped just now; the third in the room is none of them."""
    core = AdhesionMonitor(Adhesion(detector="switching"), [BENCH_MOTOR] * 3, RULES, TICK)
    core.record["n"] = core.switching.record["n"] = 2
    core.known[:], core.loads["regripped_s"][:2] = 1, 1.0
    core.loads["command_ratio"] = 1.0
    lib.adhesion_detect(pointer("struct adhesion", core.record))
    assert core.switching.loads["apart"][:2].tolist() == [0, 0]


@pytest.mark.parametrize("bad", [True, False])
def test_a_flagged_wheel_that_has_gripped_may_be_held_back(bad):
    gripped = {"loads__load": 0.5, "loads__regripped_s": 1.0, "rotors__above": 1}
    left_s = by_memory(bad=bad, **gripped).loads["regripped_s"][0]
    assert left_s == (2.0 if bad else pytest.approx(0.99))


@pytest.mark.parametrize(("p", "grips"), [(0.1, True), (0.1001, False)])
def test_on_the_limit_a_wheel_that_has_gripped_answers_its_command(p, grips):
    gripped = {"loads__load": 0.5, "loads__regripped_s": 1.0, "rotors__above": 1}
    core = by_memory(loads__response_valid=1, loads__p_response=p, **gripped)
    assert (core.loss_probability[0] == 0.0) == grips


@pytest.mark.parametrize(("learnt_s", "left_s"), [(0.5, 2.0), (0.499, 0.0)])
def test_on_the_limit_a_drive_that_is_known_again_has_turned_with_the_others(learnt_s, left_s):
    core = by_memory(loads__unknown_s=0.1, rotors__learnt_s=learnt_s)
    assert core.loads["regripped_s"][0] == left_s
