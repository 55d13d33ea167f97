"""`load_reference.c` and `command_response.c` against NumPy: any loads, extreme ones too."""

import numpy as np
import pytest
from _traction_core import ffi, lib

from estimators.detect import Opinion
from tests.learnt import Loads, Responses
from tests.reference import command_response as response
from tests.reference import load_reference as reference

SPREAD = 0.7 / 30.0
DT = 0.01
CLOSE = {"rtol": 1e-12, "atol": 1e-14}


def same(kept, plain):
    for name in ("ratio", "variance", "residual"):
        np.testing.assert_allclose(kept.ratios[name], getattr(plain, name), **CLOSE)
    np.testing.assert_array_equal(kept.ratios["seen"], plain.seen)
    np.testing.assert_allclose(kept.spread, plain.spread, **CLOSE)


def test_constants_are_those_of_the_reference():
    assert lib.LEARN_PERIOD_S == reference.EVERY_S
    assert lib.UNDECIDED == response.OPEN


def test_nothing_is_learnt_at_the_start():
    same(Loads(4, SPREAD), reference.start(4, SPREAD))


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("n", [1, 2, 3, 16])
def test_watching_and_learning(n, relative):
    rng = np.random.default_rng(n)
    plain, kept = reference.start(n, SPREAD), Loads(n, SPREAD)
    moved = False
    for _ in range(400):
        level = rng.choice([0.0, 0.05, 0.1, 0.6, -0.8])
        load = level * rng.uniform(0.7, 1.2, n) + rng.normal(0.0, SPREAD, n)
        if rng.random() < 0.05:
            load *= 10.0
        common = np.full(n, level) if relative else level * rng.uniform(0.9, 1.1, n)
        known, healthy = rng.random(n) < 0.8, rng.random(n) < 0.7
        plain = reference.watch(plain, load, common, known, relative=relative)
        plain = reference.learn(plain, load, common, healthy, relative=relative)
        kept.observe(load, common, known, healthy, relative=relative)
        same(kept, plain)
        moved |= bool(np.any(plain.ratio != 1.0))
    assert moved == (n > 1 or not relative)


def test_the_spread_and_the_ratios_stay_in_their_limits():
    for noise in (0.0, 50.0 * SPREAD):
        rng = np.random.default_rng(3)
        plain, kept = reference.start(3, SPREAD), Loads(3, SPREAD)
        for _ in range(600):
            load, everyone = 0.6 + rng.normal(0.0, noise, 3), np.ones(3, dtype=bool)
            plain = reference.watch(plain, load, 0.6, everyone)
            kept.watch(load, 0.6, everyone)
        same(kept, plain)
        limit = reference.SPREAD_MOST if noise else reference.SPREAD_FLOOR
        assert kept.spread == limit * SPREAD


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ratio_is_learnt_up_to_its_limit(sign):
    plain, kept = reference.start(2, SPREAD), Loads(2, SPREAD)
    load, everyone = 1.0 + sign * np.array([0.15, 0.0]), np.ones(2, dtype=bool)
    for _ in range(200):
        load[0] += 0.0005 * sign
        plain = reference.learn(plain, load, 1.0, everyone, relative=False)
        kept.learn(load, 1.0, everyone, relative=False)
        same(kept, plain)
    assert kept.ratio[0] == 1.0 + sign * reference.RATIO_LIMIT


def test_what_is_off_by_the_gate_is_still_learnt_and_no_drive_behind_the_last():
    kept, one = Loads(1, 0.0), np.ones(1, dtype=bool)
    kept.variance[:] = 1.0
    kept.learn(np.array([5.0]), 1.0, one, relative=False)
    assert kept.ratio[0] == 1.0 + reference.RATIO_LIMIT, "four standard deviations, not more"
    kept = Loads(3, SPREAD)
    kept.ratios["taught"], kept.ratio[2], kept.n = 7, 5.0, 2
    kept.learn(np.array([0.6, 0.62]), 0.6, np.ones(2, dtype=bool))
    assert (kept.ratios["taught"].tolist(), kept.ratio[2]) == ([1, 1, 7], 5.0)


def test_loads_as_if_the_drives_were_equal():
    rng = np.random.default_rng(11)
    for _ in range(200):
        n = int(rng.integers(1, 6))
        plain = reference.start(n, 0.02)._replace(
            ratio=rng.uniform(0.8, 1.2, n), variance=rng.uniform(0.0, 0.004, n)
        )
        kept = Loads(n, 0.02)
        kept.ratio[:], kept.variance[:] = plain.ratio, plain.variance
        load, share = rng.normal(0.0, 0.6, n), rng.uniform(0.2, 1.0, n)
        normalised, sigma = kept.normalised(load, share, 0.035)
        np.testing.assert_allclose(normalised, plain.referred(load) / share, rtol=1e-12)
        both = np.hypot(plain.sigma(load), 0.035 * load) / share
        np.testing.assert_allclose(sigma, both, rtol=1e-12)


def heard(rng, n):
    """Ten ticks of one situation: commands of one age, some answered, some not."""
    command = rng.choice([0.0, 0.05, 0.1, 0.3, -0.3, 0.9]) * np.ones(n)
    before = np.where(rng.random(n) < 0.6, command, command * rng.uniform(-0.5, 1.5, n))
    share = rng.choice([0.2, 0.85, 1.0], n)
    age_s, usable = rng.uniform(0.0, 0.05, n), rng.random(n) < 0.9
    for tick in range(10):
        load = command * share + rng.normal(0.0, SPREAD, n)
        excess = rng.choice([-1.0, 0.0, 0.4], n) * command
        braked = load + rng.choice([0.0, 0.0, 0.1, 0.6], n) * command
        age = (age_s + tick * DT) % 0.05
        yield response.Heard(load, braked, excess, command, before, age, usable)


@pytest.mark.parametrize("n", [1, 3, 16])
def test_responding(n):
    rng = np.random.default_rng(100 + n)
    plain, kept = response.start(n, SPREAD), Responses(n, SPREAD)
    met = set()
    for now in (tick for _ in range(60) for tick in heard(rng, n)):
        plain, lost, meant = response.respond(plain, now, DT)
        mine, valid = kept.respond(now, DT)
        np.testing.assert_allclose(mine, lost, **CLOSE)
        np.testing.assert_array_equal(valid, meant)
        np.testing.assert_allclose(kept.records["deficit_s"], plain.since_s, **CLOSE)
        np.testing.assert_array_equal(kept.records["braked"], plain.braked)
        for name, wanted in (("missing", plain.lack), ("missing_sigma", plain.sigma)):
            np.testing.assert_allclose(kept.records[name][meant], wanted[meant], **CLOSE)
        coasting = [lib.is_coasting(kept.each + k) for k in range(n)]
        np.testing.assert_array_equal(coasting, response.coasting(now))
        met |= {
            "lost" if p > response.CLEAR else "open" if p == response.OPEN else "" for p in lost
        } | {"braked" for one in plain.braked if one}
        healthy = lost < 0.5
        plain = response.learn(plain, now, healthy, DT)
        kept.learn_response(now, healthy, DT)
        same(kept, plain.reference)
    assert met == {"lost", "open", "", "braked"}


def test_a_sudden_loss_at_its_limits():
    """Of sizes, accelerations and times on both sides of every limit."""
    rng = np.random.default_rng(8)
    freed = 0
    for _ in range(3000):
        command = np.array([rng.choice([0.6, -0.6, 0.1])])
        load = command * rng.choice([0.0, 0.3, 0.49, 0.5, 0.51, 0.8])
        excess = command * rng.choice([-0.3, 0.0, 0.1, 0.2, 0.5])
        age_s, usable = np.full(1, 0.09), np.ones(1, dtype=bool)
        one = response.Heard(load, load, excess, command, command, age_s, usable)
        since = rng.choice([0.0, 0.01, 0.015, 0.016, 0.09])
        plain = response.start(1, SPREAD)._replace(since_s=np.full(1, since))
        kept = Responses(1, SPREAD)
        kept.records["deficit_s"] = since
        plain, lost, _ = response.respond(plain, one, DT)
        mine, _ = kept.respond(one, DT)
        np.testing.assert_allclose(mine, lost, **CLOSE)
        np.testing.assert_allclose(kept.records["deficit_s"], plain.since_s, **CLOSE)
        freed += plain.since_s[0] > 1e5
    assert freed > 100


def test_on_its_limits_a_loss_is_confirmed_and_set_free_and_a_command_steady_or_not():
    """No load at a command of 0.6; then commands beside one of zero, which a drive may answer."""

    def heard_of(load, command, before, age_s, excess=0.0):
        one = (np.full(1, x) for x in (load, load, excess, command, before, age_s))
        return response.Heard(*one, np.ones(1, dtype=bool))

    for excess, freed in ((0.25 * 0.6, True), (0.2499 * 0.6, False)):
        lost, _ = Responses(1, SPREAD).respond(heard_of(0.0, 0.6, 0.6, 0.09, excess), DT)
        assert (lost[0] != response.OPEN) == freed
    kept = Responses(1, SPREAD)
    told = [kept.respond(heard_of(0.0, 0.6, 0.6, 0.0), DT)[0][0] for _ in range(2)]
    assert told[0] == response.OPEN < told[1], "as old as a tick and the filter's lag"
    near = response.STEADY * response.LEAST_COMMAND
    for before, age_s, learnt in ((near, 0.0, 1), (1.01 * near, 0.0, 0), (0.0, DT, 0)):
        kept = Responses(1, SPREAD)
        kept.learn_response(heard_of(0.0, 0.0, before, age_s), np.ones(1, dtype=bool), DT)
        assert kept.ratios["seen"].tolist() == [learnt]


def test_fusing():
    rng = np.random.default_rng(7)
    sure = [0.0, 0.05, 0.4, 0.7, 0.99, 1.0]
    for _ in range(400):
        n = 5
        compared = Opinion(rng.choice([*sure, rng.random()], n), rng.random(n) < 0.7, 0.6)
        alone, meant = rng.choice([*sure, rng.random() ** 4], n), rng.random(n) < 0.7
        now, away = next(heard(rng, n)), rng.random(n) < 0.5
        plain = response.fuse(compared, alone, now, away, meant)
        lost, known = Responses(n, SPREAD).fuse(now, compared, alone, away, meant)
        np.testing.assert_array_equal(lost, plain.lost)
        np.testing.assert_array_equal(known, plain.known)


def test_severe_losses():
    rng = np.random.default_rng(12)
    met = set()
    for _ in range(400):
        load, command = rng.choice([0.0, 0.1, -0.1, 0.4, -0.6, 0.65], 2)
        normalised, sigma = rng.normal(0.0, 0.6), rng.choice([0.01, 0.05, 0.2])
        drive = ffi.new("struct command_response *", {"load": load, "command": command})
        for common in (0.0, 0.5, -0.5):
            wanted = common or command
            missing = np.abs(wanted) - np.sign(wanted) * (normalised if common else load)
            severe = wanted != 0.0 and missing > max(0.35 * abs(wanted), 6.0 * sigma)
            mine = lib.is_severe_loss(drive, common, normalised, sigma, 0.35, 6.0)
            assert mine == severe
            met.add((common, mine))
    assert len(met) == 6
    # Just as much as the limit is not more.
    drive = ffi.new("struct command_response *", {"load": 0.0, "command": 0.0})
    assert not lib.is_severe_loss(drive, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert not lib.is_severe_loss(drive, 0.5, 0.25, 0.01, 0.5, 6.0)
    assert not lib.is_severe_loss(drive, 0.5, 0.25, 0.25, 0.1, 1.0)


def test_numbers_that_are_none_teach_nothing_and_are_no_probability_above_one():
    rng = np.random.default_rng(6)
    odd = [0.0, 0.6, -0.3, 1e308, -1e308, 1e-320, np.nan, np.inf, -np.inf]
    for _ in range(1000):
        n = 3
        kept = Responses(n, SPREAD)
        one = response.Heard(*rng.choice(odd, (6, n)), rng.random(n) < 0.9)
        lost, _ = kept.respond(one, DT)
        assert (np.isnan(lost) | ((lost >= 0.0) & (lost <= 1.0))).all()
        kept.learn_response(one, np.ones(n, dtype=bool), DT)
        low, high = 1.0 - reference.RATIO_LIMIT, 1.0 + reference.RATIO_LIMIT
        assert (np.isnan(kept.ratio) | ((kept.ratio >= low) & (kept.ratio <= high))).all()
