"""Motors of one's own in scenarios, and worlds that detectors were not tuned on."""

import numpy as np
import pytest

from gateway.cli import main
from gateway.hil.own_motor import save_scenario, with_motor_of
from gateway.settings.config import ConfigError, load, parse
from gateway.settings.motors import TRACTION_350KW
from gateway.study import roller_world
from gateway.study.evaluation_runs import Plan, evaluate
from sim.physics.plant import LOAD, MOTORS, SPEED, TORQUE
from sim.scenario import ScenarioError, find
from sim.scenario import parse as scenario_of

MINE = {
    "R_s": 0.05, "L_s": 1.2e-3, "psi_pm": 0.45, "pole_pairs": 3, "J": 0.9, "I_rated": 90.0,
    "T_rated": 180.0,
}  # fmt: skip
"""None that ships: 180 Nm from three pole pairs."""
DRIVES = "".join(f'[[drive]]\nnode = {node}\nmotor = "mine"\n' for node in (1, 2, 3))


@pytest.fixture
def mine(tmp_path):
    """A configuration whose three drives have that motor."""
    path = tmp_path / "mine.toml"
    values = "\n".join(f"{key} = {value}" for key, value in MINE.items())
    path.write_text(f"[motor.mine]\n{values}\n{DRIVES}")
    return path


def test_the_configurations_motor_is_simulated_and_its_loss_is_found(mine, capsys):
    """With the bench motor in its place its currents mean something else, and nothing is known."""
    assert main(["hil", "release", "--config", str(mine)]) == 0, capsys.readouterr().out


def test_it_is_that_motor_and_loads_scale_with_it(mine):
    config, before = load(mine), find("release")
    after = with_motor_of(config, before)
    machine = after.motor.machine
    assert {key: getattr(machine, key) for key in MINE} == MINE
    assert machine.U_dc > 0.0
    assert after.load.torque_nm == pytest.approx(before.load.torque_nm * 6.0)
    assert after.expect == before.expect
    assert after.event == before.event
    assert after.sensors.current_noise_var == pytest.approx(
        before.sensors.current_noise_var * (90.0 / 25.0) ** 2
    )


def test_every_shipped_scenario_can_have_it(mine, tmp_path):
    from importlib import resources

    config, path = load(mine), tmp_path / "again.toml"
    for file in resources.files("sim.scenarios").iterdir():
        if not file.name.endswith(".toml"):
            continue
        scenario = with_motor_of(config, find(file.name.removesuffix(".toml")))
        save_scenario(scenario, path)
        assert find(str(path)) == scenario, file.name


def test_a_scenario_that_names_its_motor_keeps_it_and_so_does_the_bench(mine):
    named = scenario_of({"title": "a", "duration_s": 1.0, "motor": {"name": "traction_350kw"}})
    assert with_motor_of(load(mine), named) is named
    plain = find("release")
    assert with_motor_of(parse({}), plain) is plain


def test_a_motor_that_ships_is_simulated_with_its_own_train_and_a_changed_one_is_not():
    drives = [{"node": node, "motor": "traction_350kw"} for node in (1, 2, 3)]
    assert with_motor_of(parse({"drive": drives}), find("release")).motor.name == "traction_350kw"
    other = {**MINE, "psi_pm": 0.44}
    changed = with_motor_of(parse({"motor": {"bench": other}}), find("release"))
    assert changed.motor.machine.psi_pm == 0.44


def test_drives_that_are_not_alike_are_refused(mine):
    mine.write_text(mine.read_text().replace('node = 2\nmotor = "mine"', "node = 2"))
    with pytest.raises(ConfigError, match=r"the motors bench, mine; simulated ones share one"):
        with_motor_of(load(mine), find("release"))


def test_a_motor_in_the_scenario_itself():
    own = {**MINE, "U_dc": 700.0}
    scenario = scenario_of({"title": "a", "duration_s": 1.0, "motor": own})
    assert scenario.motor.machine.U_dc == 700.0
    assert scenario.motor.machine.pole_pairs == 3
    big = {key: getattr(TRACTION_350KW, key) for key in MINE} | {"U_dc": 2600.0}
    same = scenario_of({"title": "a", "duration_s": 1.0, "motor": big})
    assert same.motor.machine == MOTORS["traction_350kw"]


@pytest.mark.parametrize(
    ("motor", "problem"),
    [
        (MINE, "needs U_dc, too"),
        ({"psi_pm": 0.4}, "needs R_s, L_s, pole_pairs"),
        ({**MINE, "U_dc": 700.0, "name": "bench"}, "either name or"),
        ({"name": "bench", "B": 0.1}, "either name or"),
        ({"name": "mine"}, "for another give its parameters"),
        ({**MINE, "U_dc": 0.0}, "U_dc"),
    ],
)
def test_half_a_motor_is_refused(motor, problem):
    with pytest.raises(ScenarioError, match=problem):
        scenario_of({"title": "a", "duration_s": 1.0, "motor": motor})


def test_loss_in_a_train_of_held_speed_is_found_without_commands():
    plan = Plan(("one_mute",), ("switching",), (0, 1), world="held")
    (line,) = evaluate(plan)
    assert line.total.flags.losses == 2
    assert line.total.flags.missed == 0
    assert line.total.flags.alarms == 0


def test_family_of_another_world_is_refused_and_the_known_are_listed(capsys):
    assert main(["evaluate", "--world", "held", "--family", "crawl"]) == 2
    assert "one_mute" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "known"), [(["thermal", "--world", "held"], "ours, other"),
                         (["--world", "other"], "ours, held, roller")],
)  # fmt: skip
def test_a_world_of_the_other_side_is_refused(words, known, capsys):
    assert main(["evaluate", *words, "--seeds", "0-0"]) == 2
    assert f"known: {known}" in capsys.readouterr().err


def test_healthy_wheels_carry_what_their_motors_give_and_creep_below_the_peak():
    scenario = roller_world.draw("roller_healthy", 1)
    rows = roller_world.waveforms("roller_healthy", scenario).rows
    rated = 30.0
    assert np.abs(rows[..., LOAD] - rows[..., TORQUE]).max() < 0.02 * rated
    spread = np.ptp(rows[..., SPEED], axis=1) / np.abs(rows[..., SPEED]).min(axis=1)
    assert spread.max() < roller_world.PEAK_CREEP[1]


@pytest.mark.parametrize("name", ["roller", "roller_slow", "roller_none"])
@pytest.mark.parametrize("seed", range(2))
def test_under_a_loss_the_wheel_runs_away_as_its_effort_goes_and_never_turns_back(name, seed):
    scenario = roller_world.draw(name, seed)
    rows = roller_world.waveforms(name, scenario).rows
    (event,) = scenario.event
    lost = event.drive - 1
    speed, others = rows[:, lost, SPEED], np.delete(rows[..., SPEED], lost, axis=1).mean(axis=1)
    effort = np.sign(scenario.load.profile[0][1] * others[0])
    ahead = effort * (np.abs(speed) - np.abs(others)) / np.abs(others)
    assert ahead.max() > roller_world.PEAK_CREEP[0]
    assert (speed / others).min() > -0.1  # it may swing back by as much as its torque's lag


def test_loss_on_a_roller_is_found_and_nothing_healthy_is_flagged():
    plan = Plan(("roller", "roller_healthy"), ("switching",), (0, 1), world="roller")
    loss, healthy = evaluate(plan)
    assert loss.total.flags.losses == 2
    assert loss.total.flags.missed == 0
    assert healthy.total.flags.alarms == 0
