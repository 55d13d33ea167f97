"""The compiled memory of the detectors says what its NumPy twins say."""

import numpy as np
import pytest

from estimators.detect import Opinion, reference, response
from estimators.detect import _reference_kernels as compiled

SPREAD = 0.7 / 30.0
DT = 0.01
CLOSE = {"rtol": 1e-12, "atol": 1e-14}


def apart(memory: reference.Reference) -> reference.Reference:
    """A copy whose arrays may be changed."""
    return reference.Reference(
        *(part.copy() if isinstance(part, np.ndarray) else part for part in memory)
    )


def same(one: reference.Reference, other: reference.Reference) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, **CLOSE)


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("n", [1, 3, 16])
def test_watching_and_learning(n, relative):
    rng = np.random.default_rng(n)
    plain = reference.start(n, SPREAD)
    fast = apart(plain)
    moved = False
    for _ in range(400):
        level = rng.choice([0.0, 0.05, 0.6, -0.8])
        load = level * rng.uniform(0.7, 1.2, n) + rng.normal(0.0, SPREAD, n)
        common = np.full(n, level) if relative else level * rng.uniform(0.9, 1.1, n)
        known, healthy = rng.random(n) < 0.8, rng.random(n) < 0.7
        plain = reference.watch(plain, load, common, known, relative=relative)
        plain = reference.learn(plain, load, common, healthy, relative=relative)
        fast = fast._replace(spread=compiled.watch(fast, load, common, known, relative))
        compiled.learn(fast, load, common, healthy, relative, np.empty(n, dtype=bool))
        same(fast, plain)
        moved |= bool(np.any(plain.ratio != 1.0))
    assert moved == (n > 1 or not relative)


def heard(rng, n):
    """Ten ticks of one situation: commands of one age, some answered, some not."""
    command = rng.choice([0.0, 0.05, 0.3, -0.3, 0.9]) * np.ones(n)
    before = np.where(rng.random(n) < 0.6, command, command * rng.uniform(-0.5, 1.5, n))
    share = rng.choice([0.2, 0.85, 1.0], n)
    age_s, usable = rng.uniform(0.0, 0.05, n), rng.random(n) < 0.9
    for tick in range(10):
        load = command * share + rng.normal(0.0, SPREAD, n)
        excess = rng.choice([-1.0, 0.0, 0.4], n) * command
        yield response.Heard(load, excess, command, before, (age_s + tick * DT) % 0.05, usable)


@pytest.mark.parametrize("n", [1, 3, 16])
def test_responding(n):
    rng = np.random.default_rng(100 + n)
    plain = response.start(n, SPREAD)
    fast = response.Memory(apart(plain.reference), plain.since_s.copy())
    said = set()
    for now in (tick for _ in range(60) for tick in heard(rng, n)):
        plain, lost, meant = response.respond(plain, now, DT)
        fast_lost, fast_meant = np.empty(n), np.empty(n, dtype=bool)
        compiled.respond(fast, now, DT, fast_lost, fast_meant)
        np.testing.assert_allclose(fast_lost, lost, **CLOSE)
        np.testing.assert_array_equal(fast_meant, meant)
        np.testing.assert_allclose(fast.since_s, plain.since_s, **CLOSE)
        said |= {
            "lost" if p > response.CLEAR else "open" if p == response.OPEN else "" for p in lost
        }
        healthy = lost < 0.5
        plain = response.learn(plain, now, healthy, DT)
        spread = compiled.learn_response(fast, now, healthy, DT, *np.empty((2, n), dtype=bool))
        fast = fast._replace(reference=fast.reference._replace(spread=spread))
        same(fast.reference, plain.reference)
    assert said == {"lost", "open", ""}


def test_fusing():
    rng = np.random.default_rng(7)
    for _ in range(200):
        n = 5
        compared = Opinion(rng.random(n), rng.random(n) < 0.7, 0.6)
        alone, meant = rng.random(n) ** 4, rng.random(n) < 0.7
        now, away = next(heard(rng, n)), rng.random(n) < 0.5
        plain = response.fuse(compared, alone, now, away, meant)
        lost, known = np.empty(n), np.empty(n, dtype=bool)
        compiled.fuse(compared.lost, compared.known, alone, now, away, meant, lost, known)
        np.testing.assert_array_equal(lost, plain.lost)
        np.testing.assert_array_equal(known, plain.known)


def test_a_response_outvotes_a_comparison_only_where_it_is_sure():
    compared = Opinion(
        np.array([0.99, 0.99, 0.99, 0.1, 0.995, 0.99, 0.01]), np.ones(7, dtype=bool), 0.6
    )
    alone = np.array([0.01, 0.2, 0.01, 0.99, 0.01, response.OPEN, response.OPEN])
    zero, asked = np.zeros(7), np.full(7, 0.6)
    everyone = response.Heard(asked, zero, asked, asked, zero, np.ones(7, dtype=bool))
    meant = np.array([True, True, False, True, True, False, False])
    away = np.array([False, False, False, False, False, True, True])
    fused = response.fuse(compared, alone, everyone, away, meant)
    # The third command is on its way through zero: nothing accuses. So are the last two, but their
    # rotors run away: what accuses does, nothing clears.
    assert fused.lost.tolist() == [
        response.VETOED, 0.99, response.OPEN, 0.99, 0.995, 0.99, response.OPEN,
    ]  # fmt: skip


def test_a_drive_that_coasts_is_known_by_the_comparison_only():
    compared = Opinion(np.array([0.2, 0.2]), np.array([True, False]), 0.6)
    zero, asked = np.zeros(2), np.full(2, 0.05)
    coasts = response.Heard(zero, zero, asked, asked, zero, np.ones(2, dtype=bool))
    alone, meant = np.full(2, response.OPEN), np.zeros(2, dtype=bool)
    assert response.fuse(compared, alone, coasts, meant, meant).known.tolist() == [True, False]
    assert response.fuse(compared, alone, coasts, meant, meant).lost[0] == 0.2


def test_referred_loads_and_severe_losses_are_those_of_the_array_forms():
    rng = np.random.default_rng(11)
    for _ in range(200):
        n = int(rng.integers(1, 6))
        memory = reference.start(n, 0.02)._replace(
            ratio=rng.uniform(0.8, 1.2, n), variance=rng.uniform(0.0, 0.004, n)
        )
        load, share = rng.normal(0.0, 0.6, n), rng.uniform(0.2, 1.0, n)
        referred, spread = np.empty(n), np.empty(n)
        compiled.refer(memory, load, share, 0.035, referred, spread)
        np.testing.assert_allclose(referred, memory.referred(load) / share, rtol=1e-12)
        both = np.hypot(memory.sigma(load), 0.035 * load) / share
        np.testing.assert_allclose(spread, both, rtol=1e-12)
        known, command = rng.random(n) < 0.8, rng.normal(0.0, 0.6, n)
        zero = np.zeros(n)
        heard = response.Heard(load, zero, command, command, zero, known)
        for common in (0.0, 0.5, -0.5):
            out = np.empty(n, dtype=np.bool_)
            compiled.severely(common, heard, referred, spread, known, 0.35, 6.0, out)
            wanted = common or command
            missing = np.abs(wanted) - np.sign(wanted) * (referred if common else load)
            severe = missing > np.maximum(0.35 * np.abs(wanted), 6.0 * spread)
            np.testing.assert_array_equal(out, known & severe)
