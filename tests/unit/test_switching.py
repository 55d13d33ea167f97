"""The model with a memory by law: what it finds of trains, and what it does not."""

import copy

import numpy as np
import pytest
from _traction_core import lib
from hypothesis import given
from hypothesis import strategies as st

from estimators.detect import Evidence, SwitchingDetector
from estimators.detect.switching import Switching

NOISE = 0.01
any_load = st.floats(-1e3, 1e3) | st.sampled_from([0.0, -0.0, np.inf, -np.inf, np.nan])


def both(loads, detector=None, noise=NOISE):
    """Loads (T, N) without noise: P(lost) and P(adhering) (T, N) of each step."""
    detector, rng = detector or SwitchingDetector(), np.random.default_rng(0)
    out = []
    for load in np.asarray(loads, dtype=float):
        y = load + noise * rng.standard_normal(len(load))
        spread, known = np.full(len(load), noise), np.ones(len(load), dtype=bool)
        out.append((detector(Evidence(y, spread, known)).lost, detector.model.adhering.copy()))
    return np.array(out).swapaxes(0, 1)


def run(*given, **more):
    return both(*given, **more)[0]


def train(steps, *share, demand=0.6):
    """Loads (steps, N) of drives that carry these shares of a demand."""
    return np.tile(demand * np.array(share), (steps, 1))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("lost", [(1,), (0, 2), (1, 2)])
def test_what_falls_is_lost_and_what_comes_back_is_not(lost, sign):
    """A majority, too: the demand has not moved."""
    share = np.ones(3)
    share[list(lost)] = 0.6
    loads = np.concatenate([train(80, 1, 1, 1), train(40, *share), train(40, 1, 1, 1)])
    p = run(sign * loads)
    assert (p[70:80] < 0.01).all()
    assert ((p[85:120] > 0.9) == (share < 1)).all()
    assert (p[124:] < 0.5).all()


def test_a_step_of_the_demand_is_no_loss():
    steps = [0.6, 0.2, 0.75, -0.4, 0.5, 0.05, -0.7]
    loads = np.concatenate([train(25, 1, 1, 1, demand=m) for m in steps])
    assert (run(loads) < 0.5).all()


@pytest.mark.parametrize("ticks", [3, 10, 40])
def test_a_demand_that_turns_through_zero_is_no_loss(ticks):
    ramp = np.linspace(0.7, -0.7, ticks)
    demand = np.concatenate([np.full(60, 0.7), ramp, np.full(30, -0.7)])
    assert (run(np.outer(demand, np.ones(3))) < 0.9).all()


def test_drives_that_differ_for_good_are_learnt_and_then_a_smaller_loss_is_found():
    ratio = np.array([1.05, 0.93, 1.02])
    loads = np.concatenate([train(300, *ratio), train(60, *(ratio * [1, 1, 0.82]))])
    p = run(loads)
    assert (p[100:300] < 0.5).all()
    assert (p[305:, 2] > 0.99).all()
    assert (p[305:, :2] < 0.1).all()


def test_a_loss_that_grows_slowly_is_found():
    share = np.concatenate([np.ones(100), np.linspace(1.0, 0.5, 150)])
    p = run(0.6 * np.stack([np.ones(250), share, np.ones(250)], axis=1))
    found = int(np.argmax(p[:, 1] > 0.9))
    assert 100 < found < 170
    assert (p[:, [0, 2]] < 0.1).all()


def test_a_train_that_coasts_accuses_nobody():
    assert (run(train(300, 0, 0, 0), noise=0.02) < 0.5).all()


def test_more_load_than_the_others_is_no_loss_of_any():
    loads = np.concatenate([train(100, 1, 1, 1), train(60, 1, 1.6, 1)])
    assert (run(loads) < 0.5).all()


def test_noise_is_learnt_and_accuses_nobody():
    assert (run(train(600, 1, 1, 1), noise=0.05)[50:] < 0.9).all()


def test_a_thousand_drives():
    share = np.ones(1000)
    share[::3] = 0.5
    p = run(np.concatenate([train(40, *np.ones(1000)), train(10, *share)]))
    assert ((p[-1] > 0.9) == (share < 1)).all()


@given(st.lists(st.lists(any_load, min_size=3, max_size=3), min_size=1, max_size=30))
def test_any_loads_give_probabilities(loads):
    detector = SwitchingDetector()
    for load in loads:
        y = np.array(load)
        said = detector(Evidence(y, np.zeros(3), np.ones(3, dtype=bool)))
        model = detector.model
        total = model.adhering + model.lost
        assert ((said.lost >= 0) & (said.lost <= 1)).all()
        assert ((total > -1e-9) & (total < 1 + 1e-6)).all()
        assert np.isfinite(model.record["demand"]).all()


def test_what_nobody_knows_is_not_judged():
    detector = SwitchingDetector()
    opinion = detector(Evidence(np.array([0.5, 0.1]), np.zeros(2), np.array([True, False])))
    assert not opinion.known.any()


def test_drives_in_another_order_are_judged_alike():
    loads = np.concatenate([train(60, 1, 1.03, 0.98, 1), train(30, 1, 0.5, 0.98, 0.3)])
    p, order = run(loads, noise=0.0), [2, 0, 3, 1]
    again = run(loads[:, order], noise=0.0)
    np.testing.assert_allclose(again[-1], p[-1, order], atol=1e-3)


def test_a_step_is_10_ms_whatever_the_ticks():
    slow, fast = Switching(3), Switching(3, 2_000_000)
    for step in range(20):
        for model, ticks in ((slow, 1), (fast, 5)):
            model.loads["load"], model.loads["known"] = [0.6, 0.6, 0.6 - 0.4 * (step > 15)], 1
            for _ in range(ticks):
                lib.switching_tick(model.pointer)
        assert fast.lost.tolist() == slow.lost.tolist()


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_loss_that_was_there_before_is_found_whichever_drive_it_is(lost):
    """Nobody knows the demand yet: the first drive does not say what it is."""
    share = np.ones(3)
    share[lost] = 0.0
    p = run(np.concatenate([train(40, *share, demand=0.77), train(40, 1, 1, 1, demand=0.77)]))
    assert ((p[10:40] > 0.9) == (share < 1)).all()
    assert (p[50:] < 0.1).all()


def test_what_was_learnt_from_a_loss_that_was_there_before_is_given_up():
    """Two of three lost at the start look like drives that differ; back, they look like nothing."""
    loads = np.concatenate([
        train(60, 1, 0.74, 0.7, demand=-0.72), train(6, 1, 0.74, 1, demand=-0.72),
        train(150, 1, 1, 1, demand=-0.72),
    ])  # fmt: skip
    _, adhering = both(loads)
    assert (adhering[75:105, 1:] < 0.1).all(), "it contradicts what was learnt"
    assert (adhering[135:] > 0.9).all()


@pytest.mark.parametrize("answers", [False, True])
def test_a_train_that_carries_what_it_is_asked_for_is_not_lost_for_good(answers):
    """All slide, one after the other, and then carry half: "all lost" would explain it for ever."""
    slide = [(1, 1, 1), (0.1, 1, 1), (0.1, 0.6, 1), (0.1, 0.6, 0.5)]
    least, back = np.array([0.12, 0.28, 0.12]), np.full(3, 0.4)
    loads = 0.6 * np.concatenate([
        np.ones((60, 3)), *(np.tile(share, (7, 1)) for share in slide),
        np.linspace(slide[-1], least, 27), np.tile(least, (10, 1)), np.linspace(least, back, 27),
    ])  # fmt: skip
    detector = SwitchingDetector()
    assert (run(loads, detector)[-1] > 0.9).all()
    detector.model.loads["answers"] = [answers, answers, False]  # more than half
    p = run(0.6 * np.tile(back, (120, 1)), detector)
    assert ((p[70:] < 0.1) == answers).all()


def test_one_load_that_means_nothing_is_not_given_up_for():
    """Of three, whatever the time: the others are right."""
    loads = np.concatenate([train(60, 1, 1, 1), train(300, 1, 1.6, 1)])
    _, adhering = both(loads)
    assert (adhering[71:, [0, 2]] > 0.9).all()
    assert (adhering[71:, 1] < 0.1).all()


def test_a_scaled_load_is_as_uncertain_as_it_is():
    """The load of a drive at 30 % of the others' torque is divided by that: so is its noise."""
    accused = []
    for gain, error in ((0.0, 0.0), (2.3, 0.0), (0.0, 0.1)):
        model = Switching(3)
        model.loads["known"] = 1
        model.loads["gain"][0], model.loads["error"][0] = gain, error
        for step in range(104):
            off = 0.1 if step >= 100 else 0.0
            model.loads["load"] = 0.7 + np.array([-off, 0.0, 0.0])
            lib.switching_step(model.pointer)
        accused.append(bool(model.lost[0] > 0.9))
    assert accused == [True, False, False]


@pytest.mark.parametrize("ratio", [1.0, 0.99, 0.9, 0.5])
def test_noise_is_learnt_of_a_scaled_load_too(ratio):
    rng, model = np.random.default_rng(0), Switching(3)
    scale = np.array([1.0 / ratio, 1.0, 1.0])
    model.loads["known"], model.loads["gain"] = 1, scale - 1.0
    accused = 0
    for _ in range(1500):
        model.loads["load"] = 0.7 + 0.06 * scale * rng.standard_normal(3)
        lib.switching_step(model.pointer)
        accused += int((model.lost > 0.9).any())
    assert model.noises["variance"] ** 0.5 == pytest.approx([0.06] * 3, rel=0.35)
    assert accused < 5


def test_a_wheel_that_may_not_adhere_teaches_nothing():
    """One that finds its grip again carries more than the others while it slows down."""
    for unsure in (True, False):
        model = Switching(3)
        model.loads["known"] = 1
        for step in range(80):
            finds_grip = step < 30
            model.loads["load"] = 0.6 * np.array([1.2 if finds_grip else 1.0, 1.0, 1.0])
            model.loads["unsure"] = [finds_grip and unsure, 0, 0]
            lib.switching_step(model.pointer)
        assert bool(model.lost[0] > 0.5) is not unsure


@pytest.mark.parametrize("sign", [1, -1])
def test_a_load_far_beyond_a_small_demand_accuses_nobody(sign):
    loads = np.concatenate(
        [train(50, 1, 1, 1, demand=0.06), train(50, 1, 1, sign * 30, demand=0.06)]
    )
    assert (run(loads)[:, :2] < 0.9).all()


DAMAGED = (0.0, 1.0, -1.0, -5.0, 1e-3, 0.7, 1.3, 5.0)


@pytest.mark.parametrize("seed", range(30))
def test_damaged_records_give_numbers(seed):
    """Whatever the small filters hold: no probability beyond 0 and 1, and nothing that is none."""
    rng, model = np.random.default_rng(seed), Switching(3)
    for tick in range(40):
        small = rng.choice([1.0, 0.02, 0.04]) * np.array([1.0, 1.0, rng.choice([1.0, 50.0])])
        model.loads["load"] = np.clip(rng.uniform(-2.0, 2.0, 3) * small, -2.0, 2.0)
        model.loads["known"] = 1
        model.loads["apart"], model.loads["unsure"] = rng.random((2, 3)) < 0.1
        model.loads["gain"], model.loads["error"] = rng.choice([0.0, 0.1, 4.0], (2, 3))
        if tick % 4 == 0:
            drives = model.drives[0]
            for part in (drives, drives["now"], drives["before"]):
                for name in part.dtype.names:
                    if part.dtype[name].kind == "f" and rng.random() < 0.3:
                        part[name] = np.clip(rng.choice(DAMAGED, 3), *LIMITS.get(name, (-5.0, 5.0)))
            if rng.random() < 0.3:
                for name in ("adhering", "lost", "neither"):
                    drives[name] = 0.0
        lib.switching_step(model.pointer)
        for found in (model.adhering, model.lost):
            assert ((found > -1e-9) & (found < 1 + 1e-6)).all()
        assert np.isfinite(model.record["demand"]).all()


LIMITS = {
    "adhering": (0, 1), "lost": (0, 1), "neither": (0, 1), "fresh": (0, 1),
    "fresh_neither": (0, 1), "v_c": (1e-6, 5), "v_rr": (0, 5), "v_uu": (0, 5), "r": (0.7, 1.3),
    "u": (-0.07, 0.07), "v_ru": (-1, 1),
}  # fmt: skip
"""What a field may hold at all; v_ru may be more than both variances allow."""


def test_a_copy_goes_on_alone():
    detector = SwitchingDetector()
    run(train(50, 1, 1, 1), detector)
    twin = copy.deepcopy(detector)
    run(train(50, 1, 0.3, 1), detector)
    assert detector.model.lost[1] > 0.9 > twin.model.lost[1]


@pytest.mark.parametrize("sigma", [0.0, 0.06])
def test_noise_of_one_estimate_says_nothing_of_the_other(sigma):
    """Of filters, of the observer, of filters, off thirty times as far: they say so, or not."""
    model, rng, most = Switching(15), np.random.default_rng(1), 0.0
    model.loads["known"], model.loads["sigma"] = 1, sigma
    for step in range(400):
        filters = step < 50 or step >= 250
        model.loads["source"] = not filters
        model.loads["load"] = 0.5 + (0.06 if filters else 0.002) * rng.standard_normal(15)
        lib.switching_step(model.pointer)
        if step >= 250:
            most = max(most, model.lost.max())
    assert (most < 0.5) == (sigma > 0.0)
