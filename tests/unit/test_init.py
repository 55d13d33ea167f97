"""`init`: a first configuration from a DBC's names and units, and from a recording."""

import io
import itertools
import tomllib
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.mapping import guess
from gateway.mapping.lacks import thermal
from gateway.mapping.plan import given
from gateway.settings.config import ConfigError, load, parse
from sim.simulation import Simulation
from tests.inverters import spoken, write_dbc
from tests.simrun import codec, log_of, run, scenario

ROOT = Path(__file__).parents[2]
LAYOUTS = sorted((ROOT / "examples" / "inverters").glob("*.toml"))
MOTOR = {
    "Currents": (0x600, 10, ['PhaseA_Current : 0|16@1- (0.1,0) [0|0] "A"',
                             'PhaseB_Current : 16|16@1- (0.1,0) [0|0] "A"']),
    "Motor": (0x601, 10, ['MotorSpeed : 0|16@1- (0.1,0) [0|0] "rad/s"',
                          'TorqueFeedback : 16|16@1- (0.1,0) [0|0] "Nm"',
                          'TorqueRequest : 32|16@1- (0.1,0) [0|0] "Nm"']),
    "Others": (0x602, 100, ['StatorTemp : 0|16@1- (0.1,0) [0|0] "K"',
                            'SteeringAngle : 16|16@1- (0.1,0) [0|0] "deg"',
                            'VehicleSpeed : 32|16@1- (0.1,0) [0|0] "km/h"']),
}  # fmt: skip


def made(path):
    return tomllib.loads(path.read_text())


@pytest.fixture
def init(tmp_path, capsys):
    """The command with a DBC of these messages; its exit code."""

    def run(messages, *more, out="t.toml"):
        write_dbc(tmp_path / "m.dbc", messages)
        words = ["init", "--dbc", tmp_path / "m.dbc", "-o", tmp_path / out, *more]
        return main([str(word) for word in words])

    return run


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda path: path.stem)
def test_it_chooses_what_a_person_has_chosen(tmp_path, monkeypatch, capsys, layout):
    monkeypatch.chdir(tmp_path)
    main(["init", "--dbc", str(layout.with_suffix(".dbc")), "-o", "train.toml"])
    mine = load(Path("train.toml")).drive[0].signals.use
    wanted = load(layout).drive[0].signals.use
    assert {k: v.signal for k, v in mine.items()} == {
        k: v.signal for k, v in wanted.items() if v.signal != "Mcu_523.InverterTemperature"
    }


def test_units_are_converted_and_other_quantities_are_left(tmp_path, init):
    init(MOTOR)
    use = load(tmp_path / "t.toml").drive[0].signals.use
    assert use["Speed"].signal == "Motor.MotorSpeed"
    assert use["Speed"].scale == pytest.approx(30 / 3.14159265, rel=1e-4)
    assert use["Tstator"].offset == -273.15
    assert use["Torque"].signal == "Motor.TorqueFeedback"
    assert use["TorqueCommand"].signal == "Motor.TorqueRequest"
    assert "ElectricalAngle" not in use


@pytest.mark.parametrize(
    ("quantity", "unit", "conversion"),
    [
        ("Ia", "A/10", (0.1, 0)), ("Ia", "0.1 A", (0.1, 0)), ("Speed", "1/min", (1, 0)),
        ("Speed", "0.1 1/min", (0.1, 0)), ("Tde", "degF/10", (0.055556, -17.778)),
        ("Ia", "V/10", None), ("Torque", "0.01*Nm", (0.01, 0)), ("Ia", "A_rms", None),
        ("Irms", "Arms", (1, 0)), ("Uq", "Vrms", (1.4142, 0)), ("Ualpha", "Vrms", None),
        ("Speed", "rev/s", (60, 0)), ("Ib", "Apk", (1, 0)),
    ],
)  # fmt: skip
def test_a_unit_may_have_a_factor(quantity, unit, conversion):
    assert guess.conversion(quantity, unit) == conversion


@pytest.fixture
def used_of(tmp_path, init):
    """Signals and scales that `init` takes from a DBC, by quantity."""

    def read(messages):
        init(messages)
        use = load(tmp_path / "t.toml").drive[0].signals.use
        return {name: (one.signal, one.scale) for name, one in use.items()}

    return read


def fields(unit, *names):
    return [f'{name} : {16 * k}|16@1- (0.1,0) [0|0] "{unit}"' for k, name in enumerate(names)]


def test_an_rms_current_is_an_amplitude_in_dq_and_no_phase_current(used_of):
    """The inverter of a solar car sends both phases as RMS, and the vector as amplitudes."""
    use = used_of({
        "Cur": (0x600, 10, fields("A_rms", "PhaseCurrentA", "PhaseCurrentB", "Irms")),
        "Vector": (0x601, 10, fields("Arms", "Id", "Iq"))})  # fmt: skip
    assert use == {
        "Id": ("Vector.Id", 1.4142), "Iq": ("Vector.Iq", 1.4142), "Irms": ("Cur.Irms", 1.0)
    }  # fmt: skip


def test_signals_of_two_drives_are_not_mixed(used_of):
    """The messages of the drives have the same layout, and differ in one word."""
    use = used_of({
        f"{side}_{name}": (0x600 + 16 * k + at, 10, fields(unit, *names))
        for k, side in enumerate(("Right", "Left"))
        for at, (name, unit, names) in enumerate([
            ("PhaseCurrents", "A", ("PhaseA_Current", "PhaseB_Current")),
            ("Velocity", "rev/s", ("Vel_Estimate",)),
            ("Rms", "Arms", ("MotorCurrentRms",))])})  # fmt: skip
    assert {signal.split("_")[0] for signal, _ in use.values()} == {"Left"}
    assert use["Speed"] == ("Left_Velocity.Vel_Estimate", 60.0)
    assert {*use} == {"Ia", "Ib", "Speed", "Irms"}


def test_a_signal_that_is_only_proposed_stays_free_for_another_quantity(used_of, capsys):
    """The torque that a servo drive is given may not be taken for the torque that it has."""
    use = used_of({"Set_Torque": (0x602, 10, fields("Nm", "Input_Torque"))})
    assert use == {"TorqueCommand": ("Set_Torque.Input_Torque", 1.0)}
    assert "Torque           may be Set_Torque.Input_Torque" in capsys.readouterr().out


def test_a_signal_without_a_unit_is_proposed_in_a_comment_only(tmp_path, capsys, init):
    init(MOTOR | {"Motor": (0x601, 10, ['MotorSpeed : 0|16@1- (0.1,0) [0|0] ""'])})
    assert "Speed" not in load(tmp_path / "t.toml").drive[0].signals.use
    assert '# Speed = "Motor.MotorSpeed"' in (tmp_path / "t.toml").read_text()
    assert "Speed            may be Motor.MotorSpeed" in capsys.readouterr().out


def test_iq_alone_is_the_torque_of_a_drive_that_sends_no_id(tmp_path, init):
    """As ODrive does."""
    init({"Get_Iq": (0x614, 10, ['Iq_Setpoint : 0|32@1- (0.01,0) [0|0] "A"',
                                 'Iq_Measured : 32|32@1- (0.01,0) [0|0] "A"']),
          "Get_Encoder_Estimates": (0x609, 10, ['Pos_Estimate : 0|32@1- (1,0) [0|0] "rev"',
                                                'Vel_Estimate : 32|32@1- (0.1,0) [0|0] "rev/s"']),
          })  # fmt: skip
    signals = load(tmp_path / "t.toml").drive[0].signals
    assert signals.use["Iq"].signal == "Get_Iq.Iq_Measured"
    assert signals.use["Speed"].scale == 60.0
    assert given(signals) == {"Motion": ("Speed", "Iq")}
    assert "no RMS current" in "; ".join(thermal(signals))


@pytest.mark.parametrize(("name", "unit"), [("ERPM", ""), ("Rpm", "ERPM"), ("eRPM", "rpm")])
def test_an_electrical_speed_is_proposed_with_pole_pairs_to_fill_in(tmp_path, init, name, unit):
    """As VESC does: used as it is, the speed would be that of the field."""
    init({**MOTOR, "Motor": (0x601, 10, [f'{name} : 0|32@1- (1,0) [0|0] "{unit}"'])})
    text = (tmp_path / "t.toml").read_text()
    assert (
        f'# Speed = {{ signal = "Motor.{name}", scale = 0.25 }}    # electrical: scale = 1' in text
    )


def test_the_blower_of_a_cabin_is_no_traction_motor(tmp_path, init):
    init(MOTOR | {
        "Cabin": (0x282, 10, ['HvacBlowerRPMActual : 0|16@1- (1,0) [0|0] "rpm"']),
        "Setup": (0x159, 10, ['LowerRpmMotor : 0|16@1- (1,0) [0|0] "rpm"'])})  # fmt: skip
    used = [one.signal for one in load(tmp_path / "t.toml").drive[0].signals.use.values()]
    assert used
    assert not [name for name in used if name.startswith(("Cabin.", "Setup."))]


def test_a_dbc_without_anything_of_a_motor_is_refused(tmp_path, capsys, init):
    assert init({"Seat": (5, 10, ['SeatHeight : 0|8@1+ (1,0) [0|0] "mm"'])}) == 2
    assert "no signal has the name and the unit" in capsys.readouterr().err
    assert not (tmp_path / "t.toml").exists()


def test_our_message_set_needs_no_signals_and_check_is_good(tmp_path, capsys):
    assert main(["init", "--drives", "2", "-o", str(tmp_path / "t.toml")]) == 0
    assert load(tmp_path / "t.toml").nodes == (1, 2)
    main(["dbc", "-o", str(tmp_path / "own.dbc")])
    words = ["init", "--dbc", str(tmp_path / "own.dbc"), "-o", str(tmp_path / "u.toml")]
    assert main(words) == 0
    assert made(tmp_path / "u.toml")["dbc"] == {"file": "own.dbc"}


def test_a_log_without_cycles_and_no_drives_are_refused(tmp_path, capsys, init):
    (tmp_path / "one.log").write_text("(1.000000) can0 600#0000000000000000\n")
    assert init(MOTOR, "--log", tmp_path / "one.log") == 2
    assert init(MOTOR, "--drives", "0") == 2
    said = capsys.readouterr().err
    assert "no message occurs often enough" in said
    assert "0: expected 1 to 16" in said
    assert not (tmp_path / "t.toml").exists()


@pytest.mark.parametrize("verb", ["check", "init"])
def test_a_log_without_a_frame_is_not_called_a_wrong_node(verb, tmp_path, refused):
    (tmp_path / "empty.log").write_text("")
    words = [tmp_path / "t.toml", "--no-timing"]
    if verb == "init":
        words = ["--drives", "1", "-o", tmp_path / "t.toml"]
    else:
        words[0].write_text("[[drive]]\nnode = 1\n")
    said = refused(verb, *words, "--log", tmp_path / "empty.log")
    assert f"{tmp_path / 'empty.log'}: no frame in the log" in said


def test_an_offset_that_is_no_number_is_named_without_a_function_of_ours(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["init", "--id-step", "abc", "-o", str(tmp_path / "t.toml")])
    said = capsys.readouterr().err
    assert "argument --id-step: 'abc' is not a whole number, such as 32 or 0x20" in said


def test_any_name_of_a_file_is_a_name_in_the_configuration(tmp_path, capsys):
    write_dbc(tmp_path / 'a "b" c.dbc', MOTOR)
    main(["init", "--dbc", str(tmp_path / 'a "b" c.dbc'), "-o", str(tmp_path / "t.toml")])
    assert load(tmp_path / "t.toml").drive[0].signals.dbc == 'a "b" c.dbc'


def test_what_is_there_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "t.toml").write_text("mine")
    assert main(["init", "-o", str(tmp_path / "t.toml")]) == 2
    assert (tmp_path / "t.toml").read_text() == "mine"


def test_drives_share_one_block_and_a_guessed_step_is_marked(tmp_path, init):
    init(MOTOR, "--drives", "3")
    text = (tmp_path / "t.toml").read_text()
    assert list(made(tmp_path / "t.toml")["inverter"]) == ["m"]
    assert text.count("GUESSED") == 2
    init(MOTOR, "--drives", "3", "--id-step", "0x20", "--id-offset", "1", out="u.toml")
    offsets = [d.signals.id_offset for d in load(tmp_path / "u.toml").drive]
    assert offsets == [1, 0x21, 0x41]
    assert "GUESSED" not in (tmp_path / "u.toml").read_text()


def test_the_step_is_found_where_the_dbc_has_all_drives(tmp_path, capsys, init):
    every = {}
    for drive, (name, (can_id, cycle, signals)) in itertools.product(range(2), MOTOR.items()):
        every[f"{name}{drive + 1}"] = (can_id + 0x10 * drive, cycle, signals)
    init(every, "--drives", "2")
    first, second = (drive.signals for drive in load(tmp_path / "t.toml").drive)
    assert (first.id_offset, second.id_offset) == (0, 0x10)
    assert first.use["Speed"].signal == "Motor1.MotorSpeed"
    printed = capsys.readouterr().out
    assert "drives 1, 2    m.dbc, identifiers moved by 0x0, 0x10\n" in printed
    assert printed.count("temperatures from Tstator") == 1, "what drives share is printed once"


def test_neither_a_multiplexer_nor_a_signal_in_use_is_proposed(tmp_path, init):
    messages = {
        "I1_Cur": (0x600, 2, [f'Ph{x} : {16 * k}|16@1- (0.1,0) [0|0] "A"'
                              for k, x in enumerate("UVW")]),
        "I1_Temps": (0x601, 100, ['Mux M : 0|8@1+ (1,0) [0|0] ""',
                                  'TempStator m0 : 8|16@1- (0.1,0) [0|0] "C"',
                                  'TempMotor m1 : 8|16@1- (0.1,0) [0|0] "C"']),
    }  # fmt: skip
    init(messages)
    others = [x for x in (tmp_path / "t.toml").read_text().splitlines() if x.startswith("#   or")]
    assert others == ["#   or I1_Temps.TempMotor"]


def test_a_log_says_cycles_and_identifiers(tmp_path, capsys, init):
    """A DBC without cycle times, and a recording of two such drives."""
    signals = ["Ia", "Ib", "Ic"], ["Ualpha", "Ubeta"], ["MotorSpeed", "MotorTorque"]
    units = "A", "V", "rpm"
    scale = 0.02, 0.1, 0.5
    messages = {}
    for k, (name, cycle) in enumerate((("Cur", 2), ("Vol", 2), ("Mot", 10))):
        texts = [
            f"{s} : {16 * j}|16@1- ({0.1 if s == 'MotorTorque' else scale[k]},0) [0|0] "
            f'"{"Nm" if s == "MotorTorque" else units[k]}"'
            for j, s in enumerate(signals[k])
        ]
        messages[name] = (0x600 + k, cycle, texts)
    write_dbc(tmp_path / "with.dbc", messages)
    use = {name: f"Cur.{name}" for name in signals[0]}
    use |= {name: f"Vol.{name}" for name in signals[1]}
    use |= {"Speed": "Mot.MotorSpeed", "Torque": "Mot.MotorTorque"}
    tables = [
        {"node": n, "signals": {"dbc": "with.dbc", "id_offset": 0x10 * n, "use": use}}
        for n in (1, 2)
    ]
    config = parse({"drive": tables}, base=tmp_path)
    frames = run(Simulation(scenario(seed=3, duration_s=2.0, drives=2), codec()), 2.0)
    log_of(tmp_path / "d.log", spoken(config, frames))
    timeless = {n: (i, 0, s) for n, (i, _, s) in messages.items()}
    words = ["--drives", "2", "--id-offset", "16", "--log", tmp_path / "d.log"]
    code = init(timeless, *words)
    said = capsys.readouterr()
    assert code == 0, said
    first, second = (drive.signals for drive in load(tmp_path / "t.toml").drive)
    assert first.cycle_ms == {"Cur": 2.0, "Vol": 2.0, "Mot": 10.0}
    assert {k: v.signal for k, v in first.use.items()} == use
    assert (first.id_offset, second.id_offset) == (0x10, 0x20)
    assert "drive 2        fits: phase currents add up" in said.out
    assert "DOES NOT FIT" not in said.out
    slower = {n: (i, 30 if n == "Mot" else c, s) for n, (i, c, s) in messages.items()}
    assert init(slower, *words, out="slower.toml") == 0, "the log corrects the DBC"
    assert load(tmp_path / "slower.toml").drive[0].signals.cycle_ms == {"Mot": 10.0}
    with (tmp_path / "d.log").open("a") as file:
        file.write("(9.000000) can1 123#00\n")
    assert init(timeless, *words, out="two.toml") == 2
    assert "has several channels (can0, can1, ..); name one with --log-channel" in (
        capsys.readouterr().err
    )
    assert not (tmp_path / "two.toml").exists()
    assert init(timeless, *words, "--log-channel", "can0", out="two.toml") == 0


def test_signals_that_make_no_message_are_not_called_a_wrong_log(tmp_path, capsys, init):
    """Speed alone: `Motion` needs a torque."""
    lines = "".join(f"({k / 100:.6f}) can0 601#0100\n" for k in range(100))
    (tmp_path / "d.log").write_text(lines)
    speed = {"Mot": (0x601, 10, ['MotorSpeed : 0|16@1- (0.5,0) [0|0] "rpm"'])}
    assert init(speed, "--log", tmp_path / "d.log") == 2
    out = capsys.readouterr().out
    assert "DOES NOT FIT: its mapped signals do not complete any message" in out


@pytest.mark.parametrize(("raw", "problem"), [
    ({"drive": [{"node": 1, "inverter": "mime"}], "inverter": {"mine": {}}},
     "drive.0.inverter: no [inverter.mime]; did you mean 'mine'?"),
    ({"drive": [{"node": 1, "id_offset": 3}]}, "drive.0.id_offset: needs an `inverter`"),
    ({"drive": [{"node": 1, "inverter": "a", "signals": {}}], "inverter": {"a": {}}},
     "drive.0: has an `inverter` and `signals`"),
    ({"inverter": {"a": {}}}, "inverter: no [[drive]] names one"),
    ({"inverter": 3}, "inverter: expected a table"),
    ({"drive": [{"node": 1, "inverter": "a"}, {"node": 2, "inverter": "a"}],
      "inverter": {"a": {"dbc": "x", "use": {"Speeed": "A.B"}}}}, "inverter.a.use.Speeed"),
])  # fmt: skip
def test_mistakes_with_inverters_are_said_once(raw, problem):
    with pytest.raises(ConfigError) as caught:
        parse(raw)
    assert len([line for line in caught.value.problems if problem in line]) == 1


def test_a_question_without_an_answer_and_a_log_that_is_no_file_leave_no_configuration(
    tmp_path, monkeypatch, refused
):
    output = tmp_path / "train.toml"
    no_file = f"{tmp_path}: a folder, not a log"
    assert no_file in refused("init", "--drives", 2, "--log", tmp_path, "-o", output)
    monkeypatch.setattr("sys.stdin", EndedTerminal())
    assert "init: no answer; give --drives and --dbc" in refused("init", "-o", output)
    assert not output.exists()


class EndedTerminal(io.StringIO):
    """A terminal at which the user has pressed Ctrl-D."""

    def isatty(self):
        return True
