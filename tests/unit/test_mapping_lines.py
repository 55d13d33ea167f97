"""Errors of mapped signals: all at once, each with the line and the key where it stands."""

import re

import pytest

from gateway.mapping.plan import plans
from gateway.settings.config import ConfigError, load
from tests.inverters import write_dbc

HEAD = """\
[[drive]]
node = 1
inverter = "mine"

[[drive]]
node = 2
inverter = "mine"
id_offset = 0x10

[inverter.mine]
dbc = "m.dbc"
"""
USE = """\
[inverter.mine.use]
Speed = "Mot.Speed"
Torque = "Trq.Torque"
"""


def problems(tmp_path, text):
    write_dbc(tmp_path / "m.dbc", {
        "Mot": (0x601, 10, ['Speed : 0|16@1- (1,0) [0|0] "rpm"']),
        "Trq": (0x602, 0, ['Torque : 0|16@1- (1,0) [0|0] "Nm"'])})  # fmt: skip
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        plans(load(tmp_path / "t.toml"))
    return caught.value.problems


def line_of(text, start):
    return next(n for n, line in enumerate(text.splitlines(), 1) if line.startswith(start))


def test_shared_signals_are_named_where_they_stand_and_once(tmp_path):
    text = HEAD + "\n" + USE + 'Tstator = "Mot.Temp"\n'
    wrong, without = problems(tmp_path, text)
    number = line_of(text, "Tstator")
    assert wrong == (
        f"line {number}: inverter.mine.use.Tstator: Mot has no signal 'Temp'; it has Speed"
    )
    number = line_of(text, "[inverter.mine]")
    assert without == (
        f"line {number}: inverter.mine.cycle_ms.Trq: m.dbc has no cycle time of Trq: "
        "add cycle_ms.Trq"
    )


def test_a_missing_cycle_time_is_named_at_the_line_with_the_others(tmp_path):
    text = HEAD + "cycle_ms = { Mot = 20 }\n" + USE
    (line,) = problems(tmp_path, text)
    assert line.startswith(f"line {line_of(text, 'cycle_ms')}: inverter.mine.cycle_ms.Trq: ")
    text = HEAD + "cycle_ms = { Trq = 20, Moat = 20 }\n" + USE
    (line,) = problems(tmp_path, text)
    assert "inverter.mine.cycle_ms.Moat: m.dbc has no such message; remove it" in line


def test_a_drive_s_own_offset_is_named_at_the_drive(tmp_path):
    text = HEAD.replace("0x10", "0x700") + "cycle_ms = { Trq = 20 }\n" + USE
    wrong = problems(tmp_path, text)
    start = f"line {line_of(text, 'id_offset')}: drive.1.id_offset: "
    assert wrong == [
        f"{start}{name} would get the invalid identifier {can_id}; correct it"
        for name, can_id in (("Mot", "0xd01"), ("Trq", "0xd02"))
    ]


def test_an_offset_of_all_drives_is_named_at_the_inverter(tmp_path):
    text = HEAD + "id_offset = 0x700\ncycle_ms = { Trq = 20 }\n" + USE
    number = line_of(text.replace("id_offset = 0x10", ""), "id_offset")
    assert any(
        line.startswith(f"line {number}: inverter.mine.id_offset: Mot would get")
        for line in problems(tmp_path, text)
    )


def test_a_missing_dbc_is_named_at_its_line(tmp_path):
    text = HEAD.replace("m.dbc", "no.dbc") + USE
    (line,) = problems(tmp_path, text)
    assert line == f"line {line_of(text, 'dbc')}: inverter.mine.dbc: no.dbc: no such file"


@pytest.mark.parametrize(
    ("text", "named"),
    [('[dbc]\nfile = "no.dbc"\n', "line 2: dbc.file: "),
     ('[thermal]\ncalibration = "no.toml"\n', "line 2: thermal.calibration: ")],
)  # fmt: skip
def test_a_file_that_is_missing_is_named_with_the_key_that_names_it(refused, tmp_path, text, named):
    path = tmp_path / "train.toml"
    path.write_text(text)
    missing = tmp_path / re.search('"(.*)"', text)[1]
    assert f"train.toml: {named}{missing}: no such file" in refused("check", path)


def test_signals_of_one_drive_keep_their_path(tmp_path):
    text = '[[drive]]\nnode = 1\n[drive.signals]\ndbc = "m.dbc"\n[drive.signals.use]\n'
    text += 'Tstator = "Mot.Temp"\n'
    (line,) = problems(tmp_path, text)
    assert line.startswith("line 6: drive.0.signals.use.Tstator: Mot has no signal")
