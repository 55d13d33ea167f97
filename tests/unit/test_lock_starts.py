"""The lock from forty starts and every degree: right within a second, never wrong and sure.

Of both motors, on both buses; and through ten thousand crossings of pi.
"""

from typing import NamedTuple

import numpy as np
import pytest

from gateway.core.codes import Health
from gateway.settings.config import BENCH_MOTOR, TRACTION_350KW, Motor
from gateway.settings.sections import Estimator
from tests.estimates import step
from tests.sample_rows import Samples
from tests.stations import Bank
from tests.thorough import some
from tests.unit.test_est_truth import BENCH, KW_350, TICK_S, Machine, motor, sampled

ANGLES = np.linspace(-np.pi, np.pi, 36, endpoint=False)
STARTS = 40
SOME = (0, 7)
"""For a change: one that rolls, one that stands."""
TURNED = 10
"""Each start's angles are a degree from those of the one before, so that all 360 are tried."""
TICK = 80
OBSERVABLE = 20.0
"""Electrical speed, rad/s, from which on a second is given; nothing is observable at standstill."""


class Kind(NamedTuple):
    """A motor and its starts: electrical speeds, rad/s, by sub-steps per sample (2 ms and 8 kHz),
    and how fast one that stands pulls away, rad/s^2."""

    ours: Motor
    plant: Machine
    fastest: dict[int, float]
    rate: tuple[float, float]


KINDS = {
    "bench": Kind(BENCH_MOTOR, BENCH, {16: 1000.0, 1: 3000.0}, (100.0, 1000.0)),
    # 140 Hz; rated torque turns the rotor and its wheelset, without a train, at 145 rad/s^2.
    "350 kW": Kind(TRACTION_350KW, KW_350, {16: 880.0, 1: 880.0}, (20.0, 100.0)),
}


def start(kind, seed, every):
    """One start of 36 motors that differ by their angle: even seeds roll, odd ones stand."""
    rng = np.random.default_rng([seed, every])
    n = len(ANGLES)
    sign = rng.choice([-1.0, 1.0])
    load = kind.ours.T_rated * rng.uniform(2.0, 25.0) / 30.0 * rng.choice([-1.0, 1.0])
    rolling = seed % 2 == 0
    w = sign * np.exp(rng.uniform(np.log(25.0), np.log(kind.fastest[every])))
    ticks = round(1.2 / TICK_S)
    if rolling:
        speed = np.full(ticks, w)
    else:
        rate = rng.uniform(*kind.rate)
        stand = round(0.2 / TICK_S)
        ticks = stand + round((abs(OBSERVABLE / rate) + 1.3) / TICK_S)
        climb = np.clip(np.arange(ticks) - stand, 0, None) * TICK_S * rate
        speed = sign * np.minimum(climb, abs(w))
        load = load * (np.arange(ticks) >= stand)
    angles = ANGLES + np.radians(seed % TURNED)
    first = np.full(n, speed[0])
    profile = np.tile(speed[:, None], (1, n))
    loads = np.tile(np.broadcast_to(load, (ticks,))[:, None], (1, n))
    return motor(first, angles, profile, loads, kind.plant)


def followed(kind, truth, every, seed):
    """(T, N) which motors are said to be tracked, tick by tick: rightly, or it fails here."""
    rows = sampled(truth, every, 2e-4 * (kind.ours.I_rated / BENCH_MOTOR.I_rated) ** 2, seed)
    n = len(ANGLES)
    filters = Bank([kind.ours] * n, Estimator(), 0.02 if every == 16 else 0.05)
    out = []
    for end in range(TICK, len(truth.w) + 1, TICK):
        now = slice(*np.searchsorted(rows.tick, [end - TICK, end]))
        picked = Samples(*(column[now] for column in rows[:5]))
        said = step(filters, picked, [True] * n, end * 125_000)
        tracked = np.array([estimate.health is Health.TRACKING for estimate in said])
        w, off = truth.w[end - 1], filters.x[:, 3] - truth.theta[end - 1]
        assert (np.abs(w)[tracked] > 0.5 * OBSERVABLE).all(), "standstill is not observable"
        assert (np.abs(filters.x[:, 2] - w) < 8.0 + 0.05 * np.abs(w))[tracked].all()
        assert (np.abs(np.angle(np.exp(1j * off))) < 0.5)[tracked].all()
        out.append(tracked)
    return np.array(out)


@pytest.mark.parametrize("every", [16, 1])
@pytest.mark.parametrize("seed", some(SOME, sorted({*range(STARTS)} - {*SOME})))
@pytest.mark.parametrize("name", KINDS)
def test_forty_starts_from_every_degree(name, seed, every):
    truth = start(KINDS[name], seed, every)
    tracked = followed(KINDS[name], truth, every, seed)
    slow = np.abs(truth.w) < OBSERVABLE
    passed = len(slow) - np.argmax(slow[::-1], axis=0) if slow.any() else 0
    assert tracked.any(axis=0).all()
    first = TICK * (1 + np.argmax(tracked, axis=0))
    assert ((first - passed) * TICK_S <= 1.0).all()


@pytest.mark.parametrize("every", [16, 1])
def test_ten_thousand_crossings_of_pi_and_never_lost(every):
    n, ticks, w = len(ANGLES), round(2.2 / TICK_S), 1000.0
    speed = np.full((ticks, n), w) * np.where(np.arange(n) % 2, 1.0, -1.0)
    loads = np.full((ticks, n), 10.0)
    truth = motor(speed[0].copy(), ANGLES.copy(), speed, loads, BENCH)
    tracked = followed(KINDS["bench"], truth, every, 1)
    settled = len(tracked) // 5
    assert tracked[settled:].all()
    turned = np.abs(truth.w[settled * TICK :]).sum() * TICK_S
    assert turned / (2.0 * np.pi) > 10_000
