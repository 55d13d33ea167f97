"""The slip-protection bench: its laws, on a small selection. Figures: `python -m bench.slip`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from gateway.hil.slip_bench import CONTROLLERS, ride, ride_with_gateway
from gateway.hil.slip_plant import BrakingTrain, Seen, creep_of
from gateway.hil.slip_rails import AXLES, LIBRARY, held, seeded
from gateway.hil.slip_score import score
from sim.physics.plant import DT
from tests.thorough import some


@cache
def scored(track: str, controller: str, seed: int = 0):
    return ride(LIBRARY[track], CONTROLLERS[controller](seed), controller).score


@pytest.mark.parametrize("track", some(["leaves"], ["wet", "degraded"]))
def test_who_knows_the_coefficient_uses_it_and_nobody_else_beats_that(track):
    oracle = scored(track, "oracle")
    assert oracle.score >= 0.97
    assert oracle.worst_creep < 0.25
    assert oracle.locked_s == 0.0
    others = {name: scored(track, name) for name in ("creep", "late", "timid", "none")}
    assert max(s.score for s in others.values()) < oracle.score
    assert others["creep"].score > max(others[bad].score for bad in ("late", "timid", "none"))
    assert min(s.stopping_m for s in others.values()) > oracle.stopping_m


def test_without_protection_wheels_lock_and_the_score_says_so():
    none = scored("leaves", "none")
    assert none.locked_s > 5.0
    assert none.score < 0.6
    assert none.worst_creep > 0.9


def test_on_dry_rail_there_is_nothing_to_do():
    for name in ("none", "creep", "oracle"):
        dry = scored("dry", name)
        assert dry.utilisation > 0.99
        assert dry.false_interventions == 0
        assert np.isnan(dry.delay_s)


def test_letting_go_without_need_is_counted():
    def nervous(seen: Seen) -> np.ndarray:
        return np.full(AXLES, 0.5 if 2.0 < seen.t_s < 2.5 or 4.0 < seen.t_s < 4.5 else 1.0)

    found = ride(LIBRARY["dry"], nervous, "nervous").score
    assert found.false_interventions == 2 * AXLES
    assert found.utilisation < 0.95


def test_an_axle_that_obeys_nobody_locks_and_is_not_scored():
    run = ride(LIBRARY["rotation"], CONTROLLERS["oracle"](0), "oracle")
    assert max(creep_of(m)[2] for m in run.moments) > 0.9
    assert run.score.locked_s == 0.0
    assert run.score.score >= 0.97


def test_a_film_breaks_through_where_a_wheel_slides():
    held_back = ride(LIBRARY["film"], CONTROLLERS["oracle"](0), "oracle").moments[-1]
    slid = ride(LIBRARY["film"], CONTROLLERS["late"](0), "late").moments[-1]
    assert slid.peak_nm.mean() > 1.1 * held_back.peak_nm.mean()


def test_a_track_is_the_same_for_the_same_seed_and_however_time_is_cut():
    assert seeded(3) == seeded(3) != seeded(4)
    whole = BrakingTrain(seeded(3), CONTROLLERS["creep"](0))
    parts = BrakingTrain(seeded(3), CONTROLLERS["creep"](0))
    for _ in range(200):
        whole.advance(np.zeros(80))
        for count in (16, 24, 40):
            parts.advance(np.zeros(count))
    assert whole.moments[-1].t_s == pytest.approx(199 * 80 * DT)
    np.testing.assert_allclose(whole.drives.w_m, parts.drives.w_m, rtol=1e-9)
    np.testing.assert_allclose(whole.moments[-2].load_nm, parts.moments[-2].load_nm, rtol=1e-6)


def test_a_run_too_short_to_be_scored_is_refused():
    with pytest.raises(ValueError, match="before the brake is applied"):
        score(LIBRARY["dry"], BrakingTrain(LIBRARY["dry"], CONTROLLERS["none"](0)).run(0.5))


def test_stable_creep_below_the_peak_is_no_loss_and_beyond_it_is():
    below = ride_with_gateway(held(0.95), longest_s=5.0)
    assert below.score.false_interventions == 0
    assert not any((m.flag == 2).any() for m in below.moments)
    assert below.score.worst_creep > 0.01
    beyond = ride_with_gateway(held(1.05))
    assert any((m.flag == 2).any() for m in beyond.moments)


def test_with_the_gateway_on_the_bus_less_is_locked_and_more_used_than_without():
    ours = ride_with_gateway(LIBRARY["leaves"]).score
    none = scored("leaves", "none")
    assert ours.score > none.score + 0.3
    assert ours.stopping_m < none.stopping_m
    assert ours.locked_s < 0.5 * none.locked_s


@pytest.mark.parametrize(
    "track",
    # All wheels slide at once (900); one that was lost grips before the others (904).
    [LIBRARY["film"], LIBRARY["wet"], seeded(900), seeded(904)],
    ids=lambda track: track.name,
)
def test_no_wheel_locks_or_slides_as_adhering_where_all_slide_at_once(track):
    run = ride_with_gateway(track)
    assert run.score.locked_s == 0.0
    assert run.score.score > 0.85
    dangerous = np.stack([(creep_of(m) > 0.1) & (m.flag == 1) for m in run.moments])
    for axle in dangerous.T:
        longest = max(len(part) for part in "".join(map(str, axle.astype(int))).split("0"))
        assert longest * 0.01 <= 0.25
