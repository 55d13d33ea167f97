"""`switching.c` and its two helpers against NumPy: trains that drive, and any loads."""

import numpy as np
import pytest
from _traction_core import lib

from estimators.detect.switching import Switching
from tests.reference import switching as reference
from tests.thorough import some


def driven(rng, n, steps, noise=0.02):
    """Loads (steps, n) of a train: demands that step and turn, losses of one, of most, of all."""
    ratio = 1.0 + rng.uniform(-0.06, 0.06, n)
    demand, share, slope = 0.6, np.ones(n), 0.0
    for _ in range(steps):
        if rng.random() < 0.03:
            demand = rng.uniform(-0.9, 0.9)
        if rng.random() < 0.03:
            slope = rng.choice([0.0, 0.0, 0.03, -0.05])
        demand = np.clip(demand + slope, -1.0, 1.0)
        if rng.random() < 0.05:
            share = np.where(rng.random(n) < rng.choice([0.0, 0.3, 0.8]), rng.uniform(0, 0.9, n), 1)
        yield demand * ratio * share + noise * rng.standard_normal(n)


class Both:
    def __init__(self, n):
        self.core, self.plain = Switching(n), reference.Switching(n)

    def step(self, load, rng, known, apart, **others):
        """known, apart: the share of drives that are so; other inputs at random or as given."""
        core, plain, n = self.core, self.plain, len(load)
        given = {
            "known": rng.random(n) < known, "apart": rng.random(n) < apart,
            "unsure": rng.random(n) < apart, "gain": rng.choice([0.0, 0.0, 2.5], n),
            "error": rng.choice([0.0, 0.0, 0.1], n), "sigma": rng.choice([0.0, 0.01, 0.1], n),
            "answers": rng.random(n) < 0.3,
            "source": np.where(rng.random(n) < 0.05, 1 - plain.source, plain.source),
        }  # fmt: skip
        given |= others
        core.loads["load"] = load
        for name, value in given.items():
            core.loads[name] = value
        lib.switching_step(core.pointer)
        plain.step(np.array(load, dtype=float), **given)
        np.testing.assert_allclose(core.adhering, plain.adhering, rtol=0, atol=1e-7)
        np.testing.assert_allclose(core.lost, plain.lost, rtol=0, atol=1e-7)
        assert core.record["demand"].item() == pytest.approx(plain.demand, abs=1e-6)
        np.testing.assert_allclose(core.noises["variance"], plain.variance, rtol=1e-6)
        np.testing.assert_allclose(core.noises["scatter"], plain.scatter, rtol=1e-6)
        kept = core.record["kept"].item()
        assert kept == len(plain.all)
        for k, h in enumerate(plain.all):
            mine = core.drives[k]
            ratio = np.stack([[mine[s]["r"], mine[s]["u"]] for s in ("now", "before")])
            np.testing.assert_allclose(ratio.transpose(0, 2, 1), h.rho, atol=1e-6)
            np.testing.assert_allclose(mine["c"], h.c, atol=1e-5)


@pytest.mark.parametrize(("n", "noise"), [
    pytest.param(n, noise, marks=[pytest.mark.thorough] * ((n == 7) == (noise > 0.01)))
    for n in (1, 2, 3, 7) for noise in (0.005, 0.04)
])  # fmt: skip
def test_a_train_that_drives(n, noise):
    rng, both = np.random.default_rng(n), Both(n)
    met = set()
    for load in driven(rng, n, 150, noise):
        both.step(load, rng, 0.97, 0.03)
        met |= {*(both.core.lost > 0.9).tolist(), both.core.record["kept"].item()}
    assert {True, False} <= met or n == 1
    assert len(met) > 3, "several numbers of hypotheses"


@pytest.mark.parametrize("seed", some([0], [1, 2, 3]))
def test_any_loads(seed):
    rng, n = np.random.default_rng(seed), 3
    both = Both(n)
    for _ in range(120):
        load = rng.choice([0.0, 1e-3, -2.0, 2.0, 0.5, -0.5, rng.uniform(-1.5, 1.5)], n)
        # Of hypotheses that are equally likely either may come first.
        load += rng.uniform(-1e-3, 1e-3, n)
        both.step(load, rng, 0.8, 0.2)
        assert np.isfinite(both.core.adhering).all()
        total = both.core.adhering + both.core.lost
        assert (both.core.lost >= 0).all()
        assert (total <= 1 + 1e-8).all()


def test_scatter_of_another_source_begins_anew():
    rng, both = np.random.default_rng(6), Both(2)
    for step, load in enumerate(driven(rng, 2, 80)):
        both.step(load, rng, 1.0, 0.0, error=np.zeros(2), source=np.full(2, step // 25 % 2))


def test_silence_contradicts_nothing():
    """What has been learnt is not given up while no load is known for 0.6 s."""
    rng, both = np.random.default_rng(5), Both(3)
    for load in driven(rng, 3, 60):
        both.step(load, rng, 1.0, 0.0)
    for _ in range(60):
        both.step(load, rng, 0.0, 0.0)
    assert abs(both.core.drives[0]["now"]["r"] - 1.0).max() > 0.01


def test_what_lies_behind_the_drives_is_left_alone():
    """Room for three, of which two are in use."""
    model = Switching(3)
    model.record["n"] = 2
    behind = model.noises[2].tobytes()
    for _ in range(30):
        model.loads["load"], model.loads["known"] = 0.6, 1
        lib.switching_step(model.pointer)
    assert model.noises[2].tobytes() == behind != model.noises[1].tobytes()


@pytest.mark.parametrize(
    ("variance", "demand", "adhering", "noted", "learnt"),
    [
        (0.01, 0.7, 1.0, False, False),  # of the demand, from which on it is known
        (2.0**-8, 0.05, 1.0, True, True),
        (2.0**-8, 0.0499, 1.0, True, False),
        (2.0**-8, 0.7, 0.5, True, True),
        (2.0**-8, 0.7, 0.499, True, False),
    ],
)
def test_noise_is_learnt_from_these_limits_on(variance, demand, adhering, noted, learnt):
    model = Switching(2)
    model.loads["known"], model.loads["load"] = 1, demand
    model.hypotheses["m"][0], model.hypotheses["v_mm"][0] = demand, variance
    model.adhering[:] = adhering
    lib.switching_learn_noises(model.pointer)
    assert model.noises["count"].tolist() == [noted] * 2
    assert (model.noises["learnt_s"] > 0.0).tolist() == [learnt] * 2
