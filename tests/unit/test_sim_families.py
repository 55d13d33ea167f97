"""Families of random runs: pure functions of the seed, and what they promise."""

import numpy as np
import pytest

from dbc.codec import bind
from gateway.study.scenarios_family import DEVELOPMENT, FAMILIES, GROUPS, REPORTING, draw
from gateway.study.scenarios_random import random_scenario
from sim.simulation import Simulation
from tests.simrun import CLASSIC, run

SEEDS = range(24)
LOSSY = [name for name, family in FAMILIES.items() if not family.healthy]


def losses(scenario):
    return [e for e in scenario.event if e.kind in ("adhesion_loss", "rail")]


def simulated(name, seed, motor="bench", seconds=None):
    s = draw(name, seed, motor)
    simulation = Simulation(s, bind(CLASSIC, tuple(range(1, s.drives + 1))))
    run(simulation, s.duration_s if seconds is None else seconds)
    return s, simulation.truth_rows()


@pytest.mark.parametrize("motor", ["bench", "traction_350kw"])
@pytest.mark.parametrize("name", FAMILIES)
def test_families_are_pure_functions_of_the_seed(name, motor):
    runs = [draw(name, seed, motor) for seed in SEEDS]
    assert runs == [draw(name, seed, motor) for seed in SEEDS]
    assert len({run.model_dump_json() for run in runs}) == len(runs)
    for seed, one in zip(SEEDS, runs, strict=True):
        assert one.seed == seed
        assert one.motor.name == (FAMILIES[name].motor or motor)
        assert one.duration_s <= 20.0
        assert (one.bus.bitrate == 0) == (one.drives > 4)
        assert all(e.end_s < one.duration_s for e in losses(one))


def test_what_a_seed_means_never_changes():
    # Figures are only comparable while these stand; new families go to the end.
    assert list(FAMILIES)[:14] == [
        "single", "majority", "n1", "n2", "n12", "n16", "braking", "gradual", "crawl", "rough",
        "large", "all_together", "healthy_hard", "healthy_rough",
    ]  # fmt: skip
    assert draw("single", 7) == random_scenario(7)
    assert draw("rough", 0).event[1].at_s == 2.7451
    assert not set(DEVELOPMENT) & set(REPORTING)


def test_unknown_names_are_refused():
    with pytest.raises(KeyError):
        draw("nonsense", 0)
    with pytest.raises(KeyError):
        draw("single", 0, "nonsense")


@pytest.mark.parametrize("name", LOSSY)
def test_lossy_families_lose_between_20_and_100_percent(name):
    found = [e for seed in SEEDS for e in losses(draw(name, seed))]
    assert len(found) >= len(SEEDS) // 3
    for event in found:
        assert event.for_s >= 0.1
        if event.kind == "adhesion_loss":
            assert 0.2 <= event.depth <= 1.0


@pytest.mark.parametrize("name", [n for n in FAMILIES if FAMILIES[n].healthy])
def test_healthy_families_lose_nothing(name):
    assert not any(losses(draw(name, seed)) for seed in SEEDS)


def test_a_majority_is_one():
    for seed in SEEDS:
        s = draw("majority", seed)
        lost = {e.drive for e in losses(s)}
        assert s.drives / 2 < len(lost) < s.drives
        starts = [e.at_s for e in losses(s)]
        assert max(starts) - min(starts) <= 0.05


def test_braking_pulls_against_the_motion():
    for seed in SEEDS:
        s = draw("braking", seed)
        first, last = (speed for _, speed in s.motion.profile)
        assert first * s.load.torque_nm < 0
        assert abs(first) > abs(last)
        assert first * last > 0


def test_other_motors_are_scaled_per_unit():
    small, big = draw("rough", 3), draw("rough", 3, "traction_350kw")
    assert big.load.torque_nm / small.load.torque_nm == pytest.approx(796 / 30, rel=1e-3)
    share = (240.4 / 25) ** 2
    assert big.sensors.current_noise_var == pytest.approx(1e-2 * share)
    assert [e.at_s for e in big.event] == [e.at_s for e in small.event]


@pytest.mark.parametrize("motor", ["bench", "traction_350kw"])
@pytest.mark.parametrize("seed", [2, 4])
def test_all_together_loses_everywhere_and_only_while_the_rail_is_bad(seed, motor):
    s, rows = simulated("all_together", seed, motor)
    event = losses(s)[0]
    for drive in range(1, s.drives + 1):
        mine = [r for r in rows if r.drive == drive]
        lost = [r.t_s for r in mine if r.lost]
        assert lost[0] == pytest.approx(event.at_s, abs=0.021)
        assert all(r.lost for r in mine if event.at_s + 0.03 < r.t_s < event.end_s)
        assert min(r.depth for r in mine if event.at_s + 0.03 < r.t_s < event.end_s) > 0.2
        assert lost[-1] < event.end_s + 0.02


@pytest.mark.parametrize("motor", ["bench", "traction_350kw"])
@pytest.mark.parametrize("seed", [0, 1])
def test_hard_driving_is_healthy(seed, motor):
    s, rows = simulated("healthy_hard", seed, motor, seconds=8.0)
    assert not any(r.lost for r in rows)
    load = np.array([r.load_nm for r in rows if r.drive == 1])
    assert np.ptp(load) > 0.4 * (30 if motor == "bench" else 796)
    assert s.load.curve


def test_slides_are_of_every_kind_and_pure_functions_of_the_seed():
    group = GROUPS["slide"]
    assert not set(group) & (set(FAMILIES) | set(GROUPS["mismatch"]))
    for motor in ("bench", "traction_350kw"):
        for name in group:
            runs = [draw(name, seed, motor) for seed in SEEDS]
            assert runs == [draw(name, seed, motor) for seed in SEEDS]
            assert len({run.model_dump_json() for run in runs}) == len(runs)
            assert {np.sign(run.motion.speed) for run in runs} == {-1.0, 1.0}
    limiters = {name: {draw(name, seed).slip_limiter for seed in SEEDS} for name in group}
    assert limiters == {
        "slide_no_limiter": {"none"}, "slide_slow_limiter": {"slow"}, "slide_braked": {"fast"},
    }  # fmt: skip
    grows = [draw("slide_no_limiter", seed).event[0].ramp_s > 0.1 for seed in SEEDS]
    assert 0.25 < np.mean(grows) < 0.75
    assert all(draw("slide_braked", s).event[0].drive == "all" for s in SEEDS)


def test_mismatches_are_the_same_runs_but_for_what_is_off():
    group = GROUPS["mismatch"]
    assert not set(group) & set(FAMILIES)
    for seed in SEEDS:
        plain = draw("off_nothing", seed)
        assert plain.mismatch == type(plain.mismatch)()
        seen = set()
        for name in group:
            other = draw(name, seed)
            seen.add((str(other.mismatch), str(other.sensors), len(other.event)))
            assert (other.motion, other.load, other.seed) == (plain.motion, plain.load, plain.seed)
            losses = [e for e in other.event if e.kind == "adhesion_loss"]
            assert len(losses) == 1
            same = plain.event[0].model_dump(exclude={"drive"})
            assert losses[0].model_dump(exclude={"drive"}) == same
        assert len(seen) == len(group), "every row is off in its own way"
        opened = draw("off_phase_open", seed).event
        assert [(e.kind, e.drive) for e in opened[:1]] == [("phase_open", 1)]
        assert opened[1].drive in (2, 3), "what an open phase's wheel does nobody can say"
    assert draw("off_R_s_up", 0).mismatch.R_s == [1.2, 1.0, 1.0]
    large = draw("off_offset", 0, "traction_350kw").sensors.current_offset_within_a
    assert large > draw("off_offset", 0).sensors.current_offset_within_a
