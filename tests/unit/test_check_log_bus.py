"""`check --log`: lengths, cycle times and identifiers of the frames, and the motor's ratings."""

import re

import pytest

from dbc.e2e import protect
from dbc.frame import FD, Frame
from gateway.cli import main
from gateway.settings.config import shipped_dbc
from sim.simulation import Simulation
from tests.inverters import spoken, write_dbc
from tests.simrun import codec, log_of, run, scenario
from tests.unit.test_check_log import check, motor
from tests.unit.test_foreign import mapped

SIGNALS = '[drive.signals]\ndbc = "1.dbc"\n{more}[drive.signals.use]\n{use}'
NATIVE = "[[drive]]\nnode = 1\n"


@pytest.fixture(scope="module")
def frames():
    sent = run(Simulation(scenario(seed=5, duration_s=3.0, drives=1), codec()), 3.0)
    return [frame for frame in sent if frame.can_id & 0xF == 1]


@pytest.fixture
def theirs(tmp_path, frames):
    """Frames of a mapped drive, and the text of its configuration; `more`: keys of its signals."""
    config = mapped(tmp_path, drives=1)
    use = config.drive[0].signals.use.items()
    rows = "".join(f'{name} = "{source.signal}"\n' for name, source in use)

    def text(more=""):
        return NATIVE + SIGNALS.format(more=more, use=rows)

    return sorted(spoken(config, frames), key=lambda frame: frame.t_ns), text


def problems(lines):
    return [line.partition("DOES NOT FIT: ")[2] for line in lines if "DOES NOT FIT" in line]


def slow(frames, can_id, share):
    """Every n-th frame of one message."""
    kept = {id(f) for f in [f for f in frames if f.can_id == can_id][::share]}
    return [f for f in frames if f.can_id != can_id or id(f) in kept]


def test_a_cycle_time_that_the_log_contradicts_is_named_with_the_line_to_write(
    tmp_path, capsys, theirs
):
    frames, text = theirs
    log = log_of(tmp_path / "d.log", slow(frames, 0x612, 4))
    code, lines = check(tmp_path, text(), log, capsys)
    assert code == 2
    assert problems(lines) == ["Mot every 40 ms, configured 10 ms: set cycle_ms = { Mot = 40 }"]
    capsys.readouterr()
    _, lines = check(tmp_path, text("cycle_ms = { Mot = 40 }\n"), log, capsys)
    assert not problems(lines)


def test_a_buffered_recorder_stamps_groups_and_the_mean_is_the_cycle_time(tmp_path, capsys, theirs):
    """Frames every 10 ms, of which five are written 1 ms apart."""
    frames, text = theirs
    mot = [f for f in frames if f.can_id == 0x612]
    first = mot[0].t_ns
    grouped = [
        f._replace(t_ns=first + (k // 5 * 50 + k % 5) * 1_000_000) for k, f in enumerate(mot)
    ]
    sent = [f for f in frames if f.can_id != 0x612] + grouped
    _, lines = check(tmp_path, text(), log_of(tmp_path / "d.log", sent), capsys)
    assert not [line for line in problems(lines) if "configured" in line]
    (line,) = [line for line in lines if "come in groups" in line]
    assert "unknown: the log's time stamps of Mot come in groups, from a recorder with a" in line


def test_stamps_of_bursts_show_no_cycle_time(tmp_path, capsys, theirs):
    frames, text = theirs
    sent = [
        f._replace(t_ns=f.t_ns // 500_000_000 * 500_000_000) if f.can_id == 0x612 else f
        for f in frames
    ]
    _, lines = check(tmp_path, text(), log_of(tmp_path / "d.log", sent), capsys)
    assert not [line for line in problems(lines) if "configured" in line]
    (line,) = [line for line in lines if "cycle time of Mot cannot be checked" in line]
    assert "unknown: " in line
    assert "different time stamps" in line


def test_a_slow_drive_with_our_messages_needs_another_dbc(tmp_path, capsys, frames):
    log = log_of(tmp_path / "d.log", slow(frames, 0x381, 3))
    code, lines = check(tmp_path, NATIVE, log, capsys)
    assert code == 2
    assert any(
        line.startswith("Drive1_Motion every 30 ms, configured 10 ms: correct GenMsgCycleTime")
        for line in problems(lines)
    )


def test_peaks_far_above_the_rating_are_those_of_another_motor(tmp_path, capsys):
    load = {"kind": "preset", "torque_nm": 25.0}
    sent = run(Simulation(scenario(seed=5, duration_s=2.0, drives=1, load=load), codec()), 2.0)
    log = log_of(tmp_path / "d.log", sent)
    assert not problems(check(tmp_path, motor(), log, capsys)[1])
    tenth = {"I_rated": 2.5, "T_rated": 2.98, "J": 0.004}
    text = motor()
    for key, value in tenth.items():
        text = re.sub(rf"(?m)^{key} = .*", f"{key} = {value}", text)
    code, lines = check(tmp_path, text, log, capsys)
    assert code == 2
    current, torque = (line for line in problems(lines) if line.startswith("peak "))
    assert re.match(r"peak current 2\d A is (8|9).* x I_rated of motor mine: put", current)
    assert re.match(r"peak torque 2\d Nm is (8|9).* x T_rated of motor mine: put", torque)


def test_frames_of_another_length_are_not_called_absent(tmp_path, capsys, theirs):
    frames, text = theirs
    sent = [f._replace(data=f.data[:4]) for f in frames]
    code, lines = check(tmp_path, text(), log_of(tmp_path / "d.log", sent), capsys)
    assert code == 2
    n = sum(f.can_id == 0x612 for f in sent)
    assert any(
        f"{n} frames of 0x612 Mot have 4 bytes, the DBC says 8" in p for p in problems(lines)
    )
    assert not any("none of its messages" in line for line in lines)


def test_frames_of_can_fd_do_not_fit_a_classic_dbc(tmp_path, capsys, theirs):
    frames, text = theirs
    sent = [f._replace(flags=f.flags | FD) if f.can_id == 0x612 else f for f in frames]
    _, lines = check(tmp_path, text(), log_of(tmp_path / "d.log", sent), capsys)
    assert any("0x612 Mot are CAN FD, the DBC says classic CAN" in p for p in problems(lines))


def test_a_mapped_message_that_the_log_lacks_is_named(tmp_path, capsys, theirs):
    frames, text = theirs
    log = log_of(tmp_path / "d.log", [f for f in frames if f.can_id != 0x613])
    _, lines = check(tmp_path, text(), log, capsys)
    assert any("unknown: the log has no frame of Tmp (0x613)" in line for line in lines)


def test_values_that_never_come_together_are_not_called_absent(tmp_path, capsys):
    """Speed and torque are mapped, but only the torque's message is in the log."""
    write_dbc(tmp_path / "1.dbc", {
        "A": (0x610, 10, ['Speed : 0|16@1- (1,0) [0|0] "rpm"']),
        "B": (0x611, 10, ['Torque : 0|16@1- (1,0) [0|0] "Nm"'])})  # fmt: skip
    use = 'Speed = "A.Speed"\nTorque = "B.Torque"\n'
    log = log_of(tmp_path / "d.log", [Frame(k * 10_000_000, 0x611, bytes(8)) for k in range(99)])
    _, lines = check(tmp_path, NATIVE + SIGNALS.format(more="", use=use), log, capsys)
    assert any("the log has no frame of A (0x610)" in line for line in lines)
    assert any("its messages are in the log, but" in line for line in lines)


def ours(count, counter=0):
    """Frames that a gateway has sent."""
    spec = codec().by_name["Drive7_Estimate"]
    out = []
    for k in range(count):
        payload = codec().encode(spec, {})
        protect(spec, payload, counter + k)
        out.append(Frame(k * 10_000_000, spec.can_id, bytes(payload)))
    return out


def test_a_stranger_with_our_identifiers_is_named_with_the_key_that_moves_ours(
    tmp_path, capsys, frames
):
    """Frames of an earlier run of a gateway are none of a stranger, heartbeats included."""
    beats = [Frame(k * 10**9, 0x720, b"\x05") for k in range(3)]
    log = log_of(tmp_path / "own.log", [*frames, *ours(50), *beats])
    assert not problems(check(tmp_path, NATIVE, log, capsys)[1])
    strange = [Frame(k * 10_000_000, 0x507, bytes([k, 1, 2])) for k in range(50)]
    strange += [Frame(k * 10_000_000, 0x720, bytes(8)) for k in range(50)]
    log = log_of(tmp_path / "d.log", [*frames, *strange])
    code, lines = check(tmp_path, NATIVE, log, capsys)
    assert code == 2
    assert lines[0].startswith("gateway        DOES NOT FIT: another node sends with")
    assert "0x507 (Drive7_Estimate), 0x720 (the gateway's heartbeat), so" in lines[0]
    text = shipped_dbc("traction.dbc").read_text()
    assert "BO_ 1287 Drive7_Estimate" in text
    (tmp_path / "own.dbc").write_text(text.replace(" 1287 ", " 1543 "))
    log = log_of(tmp_path / "e.log", [*frames, *[f for f in strange if f.can_id == 0x507]])
    cured = f'[dbc]\nfile = "own.dbc"\n{NATIVE}'
    assert not problems(check(tmp_path, cured, log, capsys)[1])


def test_of_many_clashes_the_first_ones_are_listed(tmp_path, capsys, frames):
    strange = [Frame(k * 10_000_000, 0x501 + k % 10, bytes(3)) for k in range(50)]
    check(tmp_path, NATIVE, log_of(tmp_path / "d.log", [*frames, *strange]), capsys)
    assert main(["check", str(tmp_path / "t.toml"), "--no-timing", "--log",
                 str(tmp_path / "d.log")]) == 2  # fmt: skip
    assert "0x506 (Drive6_Estimate) and 4 more, so" in capsys.readouterr().out


MUX = """VERSION ""
BU_: INV
BO_ 256 Temps: 4 INV
 SG_ Mux M : 7|8@0+ (1,0) [0|3] "" INV
 SG_ Stator m0 : 15|16@0- (0.1,0) [-100|600] "degC" INV
 SG_ Ambient m3 : 15|16@0- (0.1,0) [-100|600] "degC" INV
"""


@pytest.mark.parametrize(("configured", "problem"), [
    (100, []), (25, ["Temps every 100 ms, configured 25 ms: set cycle_ms = { Temps = 100 }"]),
])  # fmt: skip
def test_a_multiplexed_message_has_the_cycle_time_of_its_signals(
    tmp_path, capsys, configured, problem
):
    (tmp_path / "m.dbc").write_text(MUX)
    more = f"cycle_ms = {{ Temps = {configured} }}\n"
    use = 'Tstator = "Temps.Stator"\nTambient = "Temps.Ambient"\n'
    text = NATIVE + 'sensors = ["stator"]\n' + SIGNALS.format(more=more, use=use)
    sent = [Frame(25_000_000 * k, 256, bytes([k % 4, 0, 200, 0])) for k in range(400)]
    _, lines = check(
        tmp_path, text.replace("1.dbc", "m.dbc"), log_of(tmp_path / "d.log", sent), capsys
    )
    assert problems(lines) == problem
