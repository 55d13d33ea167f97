"""What mapped signals lack for a flag: only what is really missing is named."""

import pytest

from gateway.cli import main
from gateway.mapping import lacks
from gateway.mapping.plan import given
from gateway.settings.signal_map import Signals
from tests.inverters import write_dbc


def signals(*names):
    return Signals(dbc="x", use={name: {"signal": f"A.{name}"} for name in names})


@pytest.mark.parametrize(
    ("names", "adhesion", "thermal"),
    [
        (("Speed", "Torque", "TorqueCommand"), ["no phase currents", "no voltages"],
         ["no temperature", "no RMS current", "no ambient temperature"]),
        (("Speed",), ["no phase currents", "no voltages", "no torque or command"],
         ["no temperature", "no RMS current", "no torque", "no ambient temperature"]),
        (("Ualpha", "Ubeta", "Torque"), ["no phase currents"],
         ["no temperature", "no RMS current", "no measured speed", "no ambient temperature"]),
        (("Id", "Iq"), ["no electrical angle", "no voltages"],
         ["no temperature", "no measured speed", "no ambient temperature"]),
        (("Irms", "Tstator", "Tambient"),
         ["no phase currents", "no voltages", "no torque or command"],
         ["no measured speed", "no torque"]),
        (("Ia", "Ib", "Ualpha", "Ubeta"), ["no torque or command"],
         ["no temperature", "no measured speed", "no torque", "no ambient temperature"]),
        (("Ia", "Ib", "Ualpha", "Ubeta", "Torque", "Speed", "Tstator", "Tambient"), [], []),
    ],
)  # fmt: skip
def test_a_mapped_signal_is_never_called_missing(names, adhesion, thermal):
    use = signals(*names)
    assert lacks.adhesion(given(use), use) == adhesion
    assert lacks.thermal(use) == thermal


SPEED = '[[drive]]\nnode = 1\ninverter = "mine"\n[inverter.mine]\ndbc = "m.dbc"\n'


@pytest.fixture
def speed_only(tmp_path):
    write_dbc(tmp_path / "m.dbc", {"Mot": (0x601, 10, ['Speed : 0|16@1- (1,0) [0|0] "rpm"'])})
    (tmp_path / "t.toml").write_text(f'{SPEED}[inverter.mine.use]\nSpeed = "Mot.Speed"\n')
    (tmp_path / "d.log").write_text("(1.000000) can0 601#0100000000000000\n")
    return tmp_path


def test_a_replay_without_any_complete_message_names_the_users_file(speed_only, capsys):
    words = ["replay", str(speed_only / "d.log"), "--config", str(speed_only / "t.toml")]
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{speed_only / 't.toml'}: line 6: inverter.mine.use: drive 1: its mapped" in line
    assert "do not complete any message: docs/inverters.md" in line
    assert "traction.dbc" not in line


def test_check_names_only_what_is_missing(speed_only, capsys):
    write_dbc(speed_only / "m.dbc", {"Mot": (0x601, 10, [
        f'{name} : {at}|16@1- (1,0) [0|0] ""'
        for at, name in ((0, "Speed"), (16, "Torque"), (32, "TorqueCommand"))])})  # fmt: skip
    use = "".join(f'{name} = "Mot.{name}"\n' for name in ("Speed", "Torque", "TorqueCommand"))
    (speed_only / "t.toml").write_text(f"{SPEED}[inverter.mine.use]\n{use}")
    assert main(["check", str(speed_only / "t.toml"), "--no-timing"]) == 2
    out, err = capsys.readouterr()
    assert "adhesion: always Unknown: no phase currents, no voltages\n" in out
    assert "no torque" not in out + err
