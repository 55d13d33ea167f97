"""`init --log`: cycle times from a recording, those of proposed signals too."""

import re
import tomllib

import pytest

from gateway.cli import main
from gateway.settings.config import load
from tests.inverters import write_dbc

MOTOR = {
    "Mot": (0x601, 0, ['MotorSpeed : 0|16@1- (0.5,0) [0|0] "rpm"']),
    "Trq": (0x602, 0, ['MotorTorqueActual : 0|16@1- (0.5,0) [0|0] ""']),
}


def recorded(path, stamps_s, can_ids=(0x601, 0x602)):
    rows = [f"({t:.6f}) can0 {i:03X}#0100000000000000\n" for t in stamps_s for i in can_ids]
    path.write_text("".join(rows))
    return str(path)


def init(tmp_path, messages, log, *more):
    write_dbc(tmp_path / "m.dbc", messages)
    words = ["init", "--dbc", str(tmp_path / "m.dbc"), "--log", log, *more]
    return main([*words, "-o", str(tmp_path / "t.toml")])


def test_stamps_of_bursts_give_no_cycle_time(tmp_path, capsys):
    log = recorded(tmp_path / "d.log", [k // 50 for k in range(400)])
    init(tmp_path, MOTOR, log)
    out, err = capsys.readouterr()
    assert "no cycle time of Mot from the log: 400 frames have only 8 different time stamps" in err
    assert "no cycle time of Mot, Trq; it is guessed: correct cycle_ms" in err
    text = (tmp_path / "t.toml").read_text()
    assert "Trq = 10 }    # ms; GUESSED, neither file nor log has them: correct it" in text
    assert float(re.search(r"bus load +(\d+) %", out)[1]) < 80


def test_one_message_with_such_stamps_is_named_beside_the_measured_ones(tmp_path, capsys):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)], [0x601])
    with (tmp_path / "d.log").open("a") as file:
        file.write("(7.990000) can0 602#0100000000000000\n" * 400)
    init(tmp_path, MOTOR, log)
    text = (tmp_path / "t.toml").read_text()
    assert "{ Mot = 20, Trq = 10 }    # ms; as in the log, except Trq: GUESSED, correct it" in text


@pytest.mark.parametrize("with_log", [True, False])
def test_a_proposed_line_can_be_used_by_removing_its_hash(tmp_path, capsys, with_log):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)])
    if with_log:
        init(tmp_path, MOTOR, log)
    else:
        write_dbc(tmp_path / "m.dbc", MOTOR)
        main(["init", "--dbc", str(tmp_path / "m.dbc"), "-o", str(tmp_path / "t.toml")])
    text = (tmp_path / "t.toml").read_text()
    assert '# Torque = "Trq.MotorTorqueActual"' in text
    cycle = 20 if with_log else 10
    assert tomllib.loads(text)["inverter"]["m"]["cycle_ms"] == {"Mot": cycle, "Trq": cycle}
    (tmp_path / "t.toml").write_text(text.replace("# Torque", "Torque"))
    capsys.readouterr()
    main(["check", str(tmp_path / "t.toml"), "--no-timing", "--log", log])
    out, err = capsys.readouterr()
    assert "motion from Speed, Torque, every" in out
    assert "no cycle time" not in err
    assert load(tmp_path / "t.toml").drive[0].signals.use["Torque"].message == "Trq"
