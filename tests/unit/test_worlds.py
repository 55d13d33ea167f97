"""The worlds that `evaluate` knows: each of its own machines, through one scorer."""

import sys

import numpy as np
import pytest

from dbc.codec import bind
from gateway.commands import evaluate as verb
from gateway.settings.config import parse
from gateway.study import roller_world
from gateway.study.evaluation_runs import Plan, evaluate, recorded
from gateway.study.held_world import OtherMachine, periods, waveforms
from gateway.study.worlds import WORLDS
from sim.physics import plant as columns
from sim.simulation import GRID, GRID_NS
from tests.simrun import scenario, values

NODES = (1, 2, 3)


def test_every_world_can_be_asked_for():
    assert set(WORLDS) == set(verb.WORLDS) - {"other"}


def test_a_run_of_the_held_kinds_on_our_machines_is_the_same_scenario():
    ours, held = (
        recorded(Plan((), ("switching",), (0,), world=name), "one", 0)
        for name in ("ours_held", "held")
    )
    assert ours.scenario == held.scenario
    rows = [[(row.t_s, row.drive, row.lost) for row in run.truth] for run in (ours, held)]
    assert rows[0] == rows[1]
    assert ours.truth[200].load_nm != held.truth[200].load_nm


def test_loss_in_a_train_of_held_speed_is_found_without_commands():
    (line,) = evaluate(Plan(("one_mute",), ("switching",), (0, 1), world="held"))
    flags = line.total.flags
    assert (flags.losses, flags.missed, flags.alarms) == (2, 0, 0)


def test_family_of_another_world_is_refused_and_the_known_are_listed(refused):
    assert "one_mute" in refused("evaluate", "--world", "held", "--family", "crawl")


@pytest.mark.parametrize(
    ("words", "known"), [(["thermal", "--world", "held"], "ours, other"),
                         (["--world", "other"], "ours, ours_held, held, motulator, roller")],
)  # fmt: skip
def test_a_world_of_the_other_side_is_refused(words, known, refused):
    assert f"known: {known}" in refused("evaluate", *words, "--seeds", "0-0")


def test_without_motulator_it_says_what_to_install(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "motulator", None)
    words = ["evaluate", "--world", "motulator", "--seeds", "0-0", "--family", "one"]
    assert "--world motulator: needs motulator" in refused(*words, "--detector", "switching")


def run_of(duration_s=0.4):
    load = {"kind": "preset", "torque_nm": 18.0}
    sensors = {"current_noise_var": 0.0}
    return scenario(duration_s=duration_s, sensors=sensors, load=load)


def frames_of(run, rows):
    codec = bind(parse({}).dbc_path, NODES)
    machines = OtherMachine(run, codec, rows)
    ticks = range(periods(run) // GRID + 1)
    return [frame for tick in ticks for frame in machines.step((), tick * GRID_NS)], codec


def test_frames_decode_to_the_waveforms_of_other_machines():
    run = run_of()
    rows = waveforms(run)
    sent, codec = frames_of(run, rows)
    currents = values(sent, "Drive2_PhaseCurrents", codec)
    voltages = values(sent, "Drive2_StatorVoltages", codec)
    assert len(currents) == len(voltages) == round(run.duration_s / 0.002) - 1
    per = 16  # periods of 125 us in 2 ms
    along = rows[per - 1 :: per, 1, [columns.I_ALPHA, columns.I_BETA]][: len(currents)]
    volts = rows[:, 1, [columns.U_ALPHA, columns.U_BETA]].reshape(-1, per, 2).mean(axis=1)
    half = np.sqrt(3.0) / 2.0
    phases = along @ np.array([[1.0, -0.5, -0.5], [0.0, half, -half]])
    shown = [[frame[name] for name in ("Ia", "Ib", "Ic")] for frame in currents]
    assert np.array(shown) == pytest.approx(phases, abs=0.0101)
    shown = [[frame[name] for name in ("Ualpha", "Ubeta")] for frame in voltages]
    assert np.array(shown) == pytest.approx(volts[: len(shown)], abs=0.0501)


def test_waveforms_that_end_too_soon():
    run = run_of()
    with pytest.raises(ValueError, match="800 rows"):
        frames_of(run, waveforms(run)[:800])


def test_healthy_wheels_carry_what_their_motors_give_and_creep_below_the_peak():
    scenario = roller_world.draw("roller_healthy", 1)
    rows = roller_world.waveforms("roller_healthy", scenario).rows
    rated = 30.0
    assert np.abs(rows[..., columns.LOAD] - rows[..., columns.TORQUE]).max() < 0.02 * rated
    spread = np.ptp(rows[..., columns.SPEED], axis=1) / np.abs(rows[..., columns.SPEED]).min(axis=1)
    assert spread.max() < roller_world.PEAK_CREEP[1]


def test_friction_brakes_slow_the_rollers_and_no_healthy_motor_carries_them():
    name, scenario = "roller_friction_healthy", roller_world.draw("roller_friction_healthy", 1)
    rows = roller_world.waveforms(name, scenario).rows
    speed = np.abs(rows[..., columns.SPEED]).mean(axis=1)
    braked = roller_world.friction(name, scenario, len(rows)) > 0.0
    assert speed[-1] < 0.99 * speed[np.flatnonzero(braked)[0]]
    assert (rows[..., columns.LOAD] * rows[..., columns.SPEED] < 0.0).all(), "motors brake"
    assert np.abs(rows[..., columns.LOAD] - rows[..., columns.TORQUE]).max() < 0.02 * 30.0


@pytest.mark.parametrize(("name", "seed"), [
    pytest.param(name, seed, marks=[pytest.mark.thorough] * (seed + k % 3 > 0))
    for k, name in enumerate(("roller", "roller_slow", "roller_none", "roller_friction"))
    for seed in (0, 1)
])  # fmt: skip
def test_under_a_loss_the_wheel_runs_away_as_its_effort_goes_and_never_turns_back(name, seed):
    scenario = roller_world.draw(name, seed)
    rows = roller_world.waveforms(name, scenario).rows
    (event,) = scenario.event
    lost = event.drive - 1
    speed, others = (
        rows[:, lost, columns.SPEED],
        np.delete(rows[..., columns.SPEED], lost, axis=1).mean(axis=1),
    )
    effort = np.sign(scenario.load.profile[0][1] * others[0])
    ahead = effort * (np.abs(speed) - np.abs(others)) / np.abs(others)
    assert ahead.max() > roller_world.PEAK_CREEP[0]
    assert (speed / others).min() > -0.1  # it may swing back by as much as its torque's lag


@pytest.mark.parametrize("seed", [1, pytest.param(0, marks=pytest.mark.thorough)])
def test_loss_on_a_roller_is_found_and_nothing_healthy_is_flagged(seed):
    names = ("roller", "roller_healthy", "roller_friction_healthy")
    loss, *healthy = evaluate(Plan(names, ("switching",), (seed,), world="roller"))
    assert (loss.total.flags.losses, loss.total.flags.missed) == (1, 0)
    assert [line.total.flags.alarms for line in healthy] == [0, 0]
