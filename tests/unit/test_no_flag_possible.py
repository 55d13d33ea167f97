"""Where no flag is possible, the messages say why, and call nothing an error that is none."""

from pathlib import Path

import pytest

from gateway.cli import main
from gateway.core.codes import Reason
from gateway.reports import cures
from gateway.settings.config import load, parse
from tests.inverters import write_dbc
from tests.unit.test_init_log import MOTOR, init, recorded

CURRENTS = {
    "Cur": (0x600, 10, ['PhaseA_Current : 0|16@1- (0.1,0) [0|0] "A"',
                        'PhaseB_Current : 16|16@1- (0.1,0) [0|0] "A"']),
    "Vol": (0x603, 10, ['Valpha : 0|16@1- (0.1,0) [0|0] "V"',
                        'Vbeta : 16|16@1- (0.1,0) [0|0] "V"']),
    "Mot": (0x601, 10, ['MotorSpeed : 0|16@1- (0.5,0) [0|0] "rpm"',
                        'MotorTorqueActual : 16|16@1- (0.5,0) [0|0] "Nm"']),
}  # fmt: skip
SPEED = {"Mot": (0x601, 20, ['MotorSpeed : 0|16@1- (0.5,0) [0|0] "rpm"',
                             'MotorTorqueActual : 16|16@1- (0.5,0) [0|0] "Nm"',
                             'MotorTorqueRequest : 32|16@1- (0.5,0) [0|0] "Nm"'])}  # fmt: skip


def test_an_inverter_without_currents_has_no_errors_to_correct(tmp_path, capsys):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)])
    assert init(tmp_path, SPEED, log) == 2
    out, err = capsys.readouterr()
    assert "configuration  good" in out
    assert "drive 1: no adhesion flag from this inverter: no phase currents, no voltages\n" in err
    assert "t.toml is right as far as it goes: map more signals for an adhesion flag" in err
    assert "has errors" not in err


def test_a_loss_not_found_with_a_motor_of_this_project_asks_for_its_own(tmp_path, capsys):
    write_dbc(tmp_path / "m.dbc", CURRENTS)
    words = ["init", "--dbc", str(tmp_path / "m.dbc"), "-o", str(tmp_path / "t.toml")]
    assert main(words) == 2
    err = capsys.readouterr().err
    assert "it has motor bench of this project: put the data of its own motor into [motor." in err
    assert "t.toml can be read: put in the motor's data, and run" in err
    assert "has errors" not in err


def test_what_does_not_fit_is_to_be_corrected(tmp_path, capsys):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)], [0x601])
    messages = {"Mot": (0x601, 100, SPEED["Mot"][2])}
    init(tmp_path, messages, log)
    assert load(tmp_path / "t.toml").drive[0].signals.cycle_ms == {"Mot": 20.0}
    capsys.readouterr()
    config = tmp_path / "t.toml"
    config.write_text(config.read_text().replace("Mot = 20", "Mot = 100"))
    assert main(["check", str(config), "--log", log]) == 2
    err = capsys.readouterr().err
    assert "Mot every 20 ms, configured 100 ms: set cycle_ms = { Mot = 20 }" in err


def test_what_init_cannot_correct_is_to_be_corrected_and_the_command_can_be_copied(
    tmp_path, capsys
):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)], [0x601])
    short = Path(log).read_text().replace("#0100", "#01")
    Path(log).write_text(short)
    assert init(tmp_path, SPEED, log) == 2
    err = capsys.readouterr().err
    again = f"traction-gateway check {tmp_path / 't.toml'} --log {log}"
    assert f"t.toml can be read; correct what does not fit, and run `{again}`" in err


def test_a_configuration_that_is_refused_has_errors(tmp_path, capsys):
    """Our own identifiers."""
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)], [0x1A0])
    assert init(tmp_path, {"Mot": (0x1A0, 20, SPEED["Mot"][2])}, log) == 2
    err = capsys.readouterr().err
    assert "has the identifier of Gateway_Adhesion" in err
    assert "t.toml has errors: correct it, and run" in err


@pytest.mark.parametrize("drives", [1, 2])
def test_maisd_is_chosen_for_two_drives_and_more(tmp_path, capsys, drives):
    write_dbc(tmp_path / "m.dbc", MOTOR)
    main(["init", "--drives", str(drives), "--dbc", str(tmp_path / "m.dbc"),
          "-o", str(tmp_path / "t.toml")])  # fmt: skip
    text, out = (tmp_path / "t.toml").read_text(), capsys.readouterr().out
    assert (load(tmp_path / "t.toml").thermal.method == "maisd") == (drives == 2)
    assert ("# No thermal flag: the model needs an ambient temperature" in text) == (drives == 1)
    assert ("no flags: every drive lacks signals that method 'model' needs" in out) == (drives == 1)
    assert ("run `traction-gateway calibrate`" in out) == (drives == 2)


def test_maisd_of_one_drive_is_never_sent_to_calibrate(tmp_path, capsys):
    (tmp_path / "t.toml").write_text('[thermal]\nmethod = "maisd"\n[[drive]]\nnode = 1\n')
    main(["check", str(tmp_path / "t.toml"), "--no-timing"])
    out = capsys.readouterr().out
    assert "thermal        no flags: method 'maisd' compares the motors of two drives" in out
    (tmp_path / "d.log").write_text("(1.000000) can0 123#00\n")
    main(["replay", str(tmp_path / "d.log"), "--config", str(tmp_path / "t.toml")])
    err = capsys.readouterr().err
    assert "so nothing was flagged; method 'maisd' compares the motors of two drives or more" in err
    assert "calibrate" not in err


def test_a_flag_that_the_signals_cannot_support_is_explained_by_the_signals(tmp_path, capsys):
    log = recorded(tmp_path / "d.log", [k / 50 for k in range(400)])
    init(tmp_path, SPEED, log)
    capsys.readouterr()
    assert main(["replay", log, "--config", str(tmp_path / "t.toml")]) == 0
    err = capsys.readouterr().err
    assert "adhesion was never known (Config), so nothing was flagged; a drive lacks signals" in err
    assert "method 'model' cannot judge a mapped drive: no RMS current, no ambient" in err


@pytest.mark.parametrize(
    ("reasons", "calibration", "said"),
    [
        ([Reason.CONFIG], None, "make limits with `traction-gateway calibrate`, or see"),
        ([Reason.STALE], None, "see `traction-gateway explain Stale`; then make limits with"),
        ([Reason.STALE, Reason.RANGE], "c.toml",
         "see `traction-gateway explain Stale`, `traction-gateway explain Range`"),
    ],
)  # fmt: skip
def test_the_cure_follows_the_reason(reasons, calibration, said):
    config = parse({"thermal": {"calibration": calibration} if calibration else {}})
    level, cure = cures.cure("thermal", reasons, config, (1, 2, 3))
    assert level == "note"
    assert cure.startswith(said)
    assert ("calibrate" in cure) == (calibration is None)


@pytest.mark.parametrize("line", [None, "auto"])
def test_the_command_that_compares_can_be_copied(tmp_path, capsys, line):
    log, more = tmp_path / "my log.log", [] if line is None else ["--line", line]
    log.write_text("(1.000000) can0 123#00\n" * 200)
    main(["replay", str(log), *more])
    pattern = f" --line {line}" if line else ""
    assert f"check CONFIG --log '{log}'{pattern}`" in capsys.readouterr().err


def test_config_is_explained_for_both_flags(capsys):
    assert main(["explain", "config"]) == 0
    out = capsys.readouterr().out
    assert "adhesion: `traction-gateway check` names the signals that the drive lacks" in out
    assert "with method `maisd` of two drives or more" in out
