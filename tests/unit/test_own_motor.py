"""Motors of one's own in scenarios."""

import pytest

import gateway
from gateway.cli import main
from gateway.hil.fitting import fitted
from gateway.hil.own_motor import save_scenario, with_motor_of
from gateway.hil.pytest.bench import HilBench
from gateway.settings.config import ConfigError, load, parse
from gateway.settings.motors import TRACTION_350KW
from sim.physics.plant import MOTORS
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
    with pytest.raises(
        ConfigError, match=r"the motors bench, mine; simulated drives share one motor"
    ):
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
        (MINE, "needs U_dc"),
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


SEVENTH = """
title = "seventh"
nodes = [3, 7, 2]
duration_s = 4
[[event]]
at_s = 2
for_s = 1
drive = 7
kind = "adhesion_loss"
depth = 0.9
[[expect]]
flag = "adhesion"
is = "bad"
drive = 7
after_s = 2
within_ms = 200
[[expect]]
flag = "adhesion"
is = "bad"
drive = "others"
never = true
"""


def train_of(folder, *nodes):
    path = folder / "train.toml"
    path.write_text("".join(f"[[drive]]\nnode = {node}\n" for node in nodes))
    return path


@pytest.mark.parametrize("nodes", [(), (3, 7, 2), (2, 3, 5, 7)])
def test_a_scenario_names_its_drives_by_their_nodes(tmp_path, nodes):
    path = tmp_path / "seventh.toml"
    path.write_text(SEVENTH)
    run = gateway.scenario(path).run(train_of(tmp_path, *nodes) if nodes else None)
    bad = {row["drive"] for row in run.events.to_pylist() if row["state"] == "AdhesionLost"}
    assert bad == {7}
    assert run.verdicts[0].passed


def test_the_drives_of_a_scenario_without_nodes_are_those_of_the_configuration(tmp_path, refused):
    config = train_of(tmp_path, 5, 7, 9)
    event = {"kind": "adhesion_loss", "depth": 0.9, "at_s": 0.2}
    given = scenario_of({"title": "a", "duration_s": 1.0, "event": [event]})
    scenario, _, _ = fitted(config, given)
    assert scenario.nodes == [5, 7, 9]
    assert given.nodes == [1, 2, 3]
    line = refused("hil", "wet_one", "--config", config)
    assert "event[0].drive: 2 is not one of the nodes 5, 7, 9" in line


def test_nodes_of_a_scenario_that_the_configuration_does_not_have_are_refused(tmp_path, refused):
    path = tmp_path / "seventh.toml"
    path.write_text(SEVENTH)
    line = refused("sim", path, "--config", train_of(tmp_path, 1, 2, 3))
    assert "the scenario has nodes 3, 7, 2, [[drive]] names 1, 2, 3" in line


def test_sim_simulates_the_nodes_and_the_motor_of_the_configuration(mine, tmp_path):
    mine.write_text(mine.read_text().replace("node = 2", "node = 9"))
    path, log, truth = tmp_path / "short.toml", tmp_path / "a.log", tmp_path / "truth.csv"
    path.write_text('title = "short"\nduration_s = 0.5\nload.kind = "preset"\n')
    files = ["-o", str(log), "--truth", str(truth)]
    assert main(["sim", str(path), "--config", str(mine), *files]) == 0
    rows = [row.split(",") for row in truth.read_text().splitlines()[1:]]
    assert {row[1] for row in rows} == {"1", "9", "3"}
    assert {float(row[4]) for row in rows} == {18.0 * 6.0}
    assert " 189#" in log.read_text()


def test_the_truth_of_a_bench_is_that_of_each_node(tmp_path):
    event = {"kind": "adhesion_loss", "depth": 0.9, "drive": 2, "at_s": 0.2}
    given = {"title": "first", "duration_s": 1, "event": [event]}
    bench = HilBench(*fitted(train_of(tmp_path, 2, 3, 1), scenario_of(given, "first")))
    bench.run(0.5)
    assert [node for node, lost in bench.lost.items() if any(one for _, one in lost)] == [2]
    bench.close()
