"""A message about a wrong value, verb, option or name says which one was probably meant."""

import pytest

from dbc.text import near
from gateway.cli import main
from gateway.settings.config import ConfigError, parse
from sim.scenario import ScenarioError, find
from sim.scenario import parse as scenario_of

EVENT = {"at_s": 0.0, "kind": "silent"}


@pytest.mark.parametrize(("given", "names", "text"), [
    ("Median", ("vb", "median"), "; did you mean 'median'?"),
    ("xyz", ("vb", "median"), ""),
    (7, ("7a", "b"), "; did you mean '7a'?"),
    ("a", (), ""),
])  # fmt: skip
def test_the_nearest_name_without_regard_to_case(given, names, text):
    assert near(given, names) == text


@pytest.mark.parametrize(("table", "meant"), [
    ({"adhesion": {"detector": "swiching"}}, "switching"),
    ({"bus": {"on_intruder": "sotp"}}, "stop"),
    ({"estimator": {"kind": "ekff"}}, "ekf"),
    ({"drive": [{"node": 1, "motor": "bnech"}]}, "bench"),
])  # fmt: skip
def test_values_of_a_configuration(table, meant):
    with pytest.raises(ConfigError, match=f"did you mean '{meant}'"):
        parse(table)


@pytest.mark.parametrize(("table", "meant"), [
    ({"event": [{**EVENT, "kind": "sient"}]}, "silent"),
    ({"event": [{**EVENT, "drive": "al"}]}, "all"),
    ({"event": [{**EVENT, "kind": "rail", "value": "wte"}]}, "wet"),
    ({"load": {"rail": "leavs"}}, "leaves"),
    ({"motor": {"name": "lrage"}}, "large"),
    ({"expect": [{"flag": "adhesin", "is": "bad"}]}, "adhesion"),
])  # fmt: skip
def test_values_of_a_scenario(table, meant):
    with pytest.raises(ScenarioError, match=f"did you mean '{meant}'"):
        scenario_of({"title": "a", "duration_s": 1.0, **table})


@pytest.mark.parametrize("name", ["wet_on", "folder/wet_on.toml"])
def test_names_of_scenarios(name):
    with pytest.raises(ScenarioError, match="did you mean 'wet_one'"):
        find(name)


@pytest.mark.parametrize(("words", "meant"), [
    (["replya"], "replay"),
    (["replay", "a.log", "--resluts", "x"], "--results"),
    (["replay", "a.log", "--resluts=x"], "--results"),
    (["replay", "a.log", "--log-format", "jsn"], "json"),
])  # fmt: skip
def test_verbs_and_options(words, meant, capsys):
    with pytest.raises(SystemExit):
        main(words)
    assert capsys.readouterr().err.endswith(f"; did you mean '{meant}'?\n")


def test_codes_and_motors_of_the_benchmark(refused):
    assert "no code 'ToFewDrives'; did you mean 'TooFewDrives'?" in refused(
        "explain", "ToFewDrives"
    )
    assert "did you mean 'bench'?" in refused("evaluate", "adhesion", "--motor", "bnech")


def test_messages_and_signals_of_another_makers_dbc(tmp_path):
    from gateway.mapping.plan import plans

    (tmp_path / "a.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 257 Inverter_Motion: 8 A\n'
        ' SG_ MotorSpeed : 0|16@1- (1,0) [0|0] "rpm" A\n'
    )
    for source, meant in (("Inverter_Moton.MotorSpeed", "Inverter_Motion"),
                          ("Inverter_Motion.MotorSped", "MotorSpeed")):  # fmt: skip
        signals = {"dbc": "a.dbc", "use": {"Speed": source}}
        drives = [{"node": 1, "signals": signals}]
        with pytest.raises(ConfigError, match=f"did you mean '{meant}'"):
            plans(parse({"drive": drives}, base=tmp_path))
