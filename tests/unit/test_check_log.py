"""`check --log`: which unit, sign, phase order, pole pair number or flux fits a recording."""

import numpy as np
import pytest

from dbc.e2e import counter_of, protect
from dbc.frame import Frame
from gateway.cli import main
from gateway.mapping import temperature_fit
from gateway.mapping.fit import Measured, findings
from gateway.settings.config import shipped_dbc
from gateway.settings.motors import BENCH_MOTOR
from sim.simulation import Simulation
from tests.inverters import spoken
from tests.simrun import TICK, Flags, codec, log_of, run, scenario
from tests.unit.test_foreign import mapped

SCENARIO = {"seed": 5, "duration_s": 4.0, "drives": 2}


@pytest.fixture(scope="module")
def frames():
    return run(Simulation(scenario(**SCENARIO), codec()), 4.0)


def check(tmp_path, text, log, capsys, *more):
    (tmp_path / "t.toml").write_text(text)
    code = main(["check", str(tmp_path / "t.toml"), "--no-timing", "--log", str(log), *more])
    lines = capsys.readouterr().out.splitlines()
    verdicts = "fits: ", "DOES NOT FIT: ", "unknown: "
    return code, [line for line in lines if any(word in line for word in verdicts)]


def motor(**changes):
    values = BENCH_MOTOR.model_dump() | changes
    values["T_rated"] = values["k_p"] * values["pole_pairs"] * values["psi_pm"] * 25.0
    rows = "".join(f"{key} = {value}\n" for key, value in values.items())
    return f'[[drive]]\nnode = 1\nmotor = "mine"\n[motor.mine]\n{rows}'


def test_what_is_right_fits(tmp_path, frames, capsys):
    log = log_of(tmp_path / "d.log", frames)
    code, lines = check(tmp_path, "[[drive]]\nnode = 1\n[[drive]]\nnode = 2\n", log, capsys)
    assert code == 0
    assert len(lines) == 12
    assert all("fits: " in line for line in lines)
    assert lines[6].startswith("drive 2 ")


@pytest.mark.parametrize(("changes", "said"), [
    ({"psi_pm": 2 * BENCH_MOTOR.psi_pm}, "flux linkage: 0.199 Wb by voltages and speed, "
     "0.5 times (half) the configured 0.3978"),
    ({"pole_pairs": 8}, "pole pairs: 4 by currents and speed, the configuration says 8"),
    ({"pole_pairs": 2}, "pole pairs: 4 by currents and speed, the configuration says 2"),
])  # fmt: skip
def test_a_wrong_parameter_is_named(tmp_path, frames, capsys, changes, said):
    log = log_of(tmp_path / "d.log", frames)
    code, lines = check(tmp_path, motor(**changes), log, capsys)
    assert code == 2
    (wrong,) = [line for line in lines if "DOES NOT FIT" in line]
    assert said in wrong


@pytest.mark.parametrize("wrong", ["pole_pairs", "Speed"])
def test_the_torque_shows_whether_pole_pairs_or_speed_are_wrong(tmp_path, frames, capsys, wrong):
    mine = codec()
    motion, sent = mine.by_name["Drive1_Motion"], []
    for frame in frames:
        if frame.can_id == motion.can_id and wrong == "Speed":
            values = {n: r.value for n, r in mine.decode(motion, frame.data).items()}
            values["Speed"] *= 0.5
            payload = mine.encode(motion, values)
            protect(motion, payload, counter_of(motion, frame.data))
            frame = frame._replace(data=bytes(payload))  # noqa: PLW2901 the same, halved
        sent.append(frame)
    log = log_of(tmp_path / "d.log", sent)
    configured = motor(pole_pairs=2) if wrong == "pole_pairs" else motor()
    code, lines = check(tmp_path, configured, log, capsys)
    assert code == 2
    (line,) = [line for line in lines if "DOES NOT FIT" in line]
    assert "pole pairs: " in line
    assert wrong == "pole_pairs" or "Speed, which then is 0.501 times (half)" in line
    (torque,) = [line for line in lines if "torque: " in line]
    other = {"pole_pairs": "Speed", "Speed": "pole_pairs"}[wrong]
    assert f"{wrong} is wrong, not {other}" in torque


def test_can_fd_fits(tmp_path, capsys):
    fd = run(Simulation(scenario(**SCENARIO), codec(path=shipped_dbc("traction_fd.dbc"))), 4.0)
    log = log_of(tmp_path / "d.log", fd)
    text = '[dbc]\nfile = "traction_fd.dbc"\n[bus]\nfd = true\n[[drive]]\nnode = 1\n'
    code, lines = check(tmp_path, text, log, capsys)
    assert code == 0
    assert [line for line in lines if "pole pairs: 4 by" in line]
    assert all("fits: " in line for line in lines)


WRONG = {
    "rad/s, not rpm": ({"Speed": ("scale", 0.10472)},
                       "which then is 0.105 times (rad/s instead of rpm) what it should be"),
    "speed of the other sign": ({"Speed": ("scale", -1.0)}, "Speed has the other sign"),
    "torque of the other sign": ({"Torque": ("scale", -1.0)},
                                 "with the other sign, that of currents"),
    "torque ten times": ({"Torque": ("scale", 10.0)}, "(ten times) that of currents"),
    "voltages line to line": ({"Ualpha": ("scale", 3**0.5), "Ubeta": ("scale", 3**0.5)},
                              "correct psi_pm or L_s, or the scale of the voltages"),
    "voltages turn back": ({"Ubeta": ("scale", -1.0)}, "the voltages turn against"),
    "phases swapped": ({"Ia": ("signal", "Cur.Ib"), "Ib": ("signal", "Cur.Ia")},
                       "two phases are swapped"),
    "another signal": ({"Ic": ("signal", "Cur.Ia")}, "one of them is a wrong signal"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", list(WRONG))
def test_a_wrong_mapping_is_named(tmp_path, frames, capsys, mistake):
    config = mapped(tmp_path, drives=1)
    only = [frame for frame in frames if frame.can_id & 0xF == 1]
    log = log_of(tmp_path / "d.log", spoken(config, only))
    changes, said = WRONG[mistake]
    rows = []
    for name, source in config.drive[0].signals.use.items():
        value = {"signal": source.signal, "scale": 1.0}
        if name in changes:
            key, to = changes[name]
            value[key] = to
        rows.append(f'{name} = {{ signal = "{value["signal"]}", scale = {value["scale"]} }}\n')
    text = (
        f'[[drive]]\nnode = 1\n[drive.signals]\ndbc = "1.dbc"\n[drive.signals.use]\n{"".join(rows)}'
    )
    code, lines = check(tmp_path, text, log, capsys)
    assert code == 2
    assert any("DOES NOT FIT" in line and said in line for line in lines), lines


def test_a_command_that_repeats_the_torque_is_named(tmp_path, frames, capsys):
    """Torque as noisy as a cheap sensor's, sent as both."""
    rng = np.random.default_rng(4)
    mine = codec()
    motion, status = mine.by_name["Drive1_Motion"], mine.by_name["Drive1_Status"]
    sent = [f for f in frames if f.can_id not in (motion.can_id, status.can_id)]
    for frame in frames:
        if frame.can_id == motion.can_id:
            torque = 18.0 + round(rng.normal(0.0, 1.0), 1)
            speed = mine.decode(motion, frame.data)["Speed"].value
            data = mine.encode(motion, {"Speed": speed, "Torque": torque})
            sent.append(frame._replace(data=bytes(data)))
            data = mine.encode(status, {"TorqueCommand": torque, "Irms": 12.0})
            sent.append(Frame(frame.t_ns + 1000, status.can_id, bytes(data)))
    log = log_of(tmp_path / "d.log", sent)
    code, lines = check(tmp_path, "[[drive]]\nnode = 1\n", log, capsys)
    assert code == 2
    assert any("DOES NOT FIT: TorqueCommand repeats Torque" in line for line in lines), lines


def test_what_a_log_does_not_show_is_unknown(tmp_path, frames, capsys):
    log = log_of(tmp_path / "d.log", [f for f in frames if f.can_id & 0x780 != 0x380])
    code, lines = check(tmp_path, "[[drive]]\nnode = 1\n", log, capsys)
    assert code == 0
    assert any("unknown: no measured speed" in line for line in lines)
    log = log_of(tmp_path / "e.log", [f for f in frames if f.can_id & 0x780 != 0x180])
    _, lines = check(tmp_path, "[[drive]]\nnode = 1\n", log, capsys)
    assert any("unknown: 0 samples of current" in line for line in lines)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        (
            lambda data: bytes([data[0] ^ 0x55]) + data[1:],
            "Drive1_PhaseCurrents: 100 of 100 frames have a wrong checksum",
        ),
        (lambda data: data[:6], "frames have 6 bytes, the DBC says 8: correct [dbc] file"),
    ],
)
def test_what_a_replay_rejects_does_not_fit(tmp_path, frames, capsys, changed, text):
    sent = [f._replace(data=changed(f.data)) if len(f.data) == 8 else f for f in frames]
    code, lines = check(tmp_path, "[[drive]]\nnode = 1\n", log_of(tmp_path / "d.log", sent), capsys)
    assert code == 2
    assert any("DOES NOT FIT" in line and text in line for line in lines), lines


def test_a_drive_that_is_not_in_the_log_does_not_fit(tmp_path, capsys):
    (tmp_path / "e.log").write_text("(1.000000) can0 123#00\n")
    code, lines = check(tmp_path, "[[drive]]\nnode = 9\n", str(tmp_path / "e.log"), capsys)
    assert code == 2
    assert any("DOES NOT FIT: the log has none of its messages" in line for line in lines)


@pytest.mark.parametrize("step_s", [2e-3, 0.0])
@pytest.mark.parametrize("noise_a", [0.05, 0.0])
def test_drives_that_stand_say_nothing(step_s, noise_a):
    """Currents of noise, or none; and stamps that are all the same."""
    rng = np.random.default_rng(1)
    t, motion_t = np.arange(4000) * step_s, np.arange(800) * 5 * step_s
    phases = rng.normal(0.0, noise_a, (3, 4000))
    phases[2, ::7] = np.nan
    still = np.zeros(800)
    data = Measured(
        t, phases[0] + 1j * phases[1], phases.sum(axis=0), np.zeros(4000, complex),
        motion_t, still, still, motion_t[::10], np.full(80, noise_a),
    )  # fmt: skip
    found = findings(data, BENCH_MOTOR)
    assert len(found) == 3
    assert all(one.fits is None for one in found)


def test_signals_that_do_not_agree_say_nothing():
    rng = np.random.default_rng(1)
    t, motion_t = np.arange(4000) * 2e-3, np.arange(800) * 1e-2
    noise = rng.normal(0.0, 10.0, (4, 4000))
    data = Measured(
        t, noise[0] + 1j * noise[1], np.zeros(0), noise[2] + 1j * noise[3],
        motion_t, rng.uniform(5.0, 60.0, 800), rng.normal(0.0, 10.0, 800),
        np.zeros(0), np.zeros(0),
    )  # fmt: skip
    found = findings(data, BENCH_MOTOR)
    assert len(found) == 2
    assert all(one.fits is None for one in found)


@pytest.mark.parametrize(("values", "fits", "cause"), [
    ({"Tambient": [20.0], "Tstator": [80.0, 82.0]}, True, "Tambient 20, Tstator 81 degC"),
    ({"Tstator": [210.0]}, True, "possible"),
    ({"Tambient": [293.0], "Tstator": [350.0]}, False, "K instead of degC (offset = -273.15)"),
    ({"Tstator": [350.0]}, False, "K instead of degC (offset = -273.15) or degF instead of degC"),
    ({"Tambient": [68.0], "Tstator": [176.0]}, False, "impossible: degF instead of degC"),
    ({"Tambient": [250.0], "Tstator": [20.0]}, False, "a wrong unit, scale or offset"),
    ({"Tambient": [27.0], "Tstator": [268.0]}, False, "or no sensor is connected for Tstator"),
    ({"Tambient": [22.0], "Tstator": [-15.0]}, None, "colder than the air"),
    ({"Tde": [np.nan, np.nan]}, None, "Tde: no value in the log"),
])  # fmt: skip
def test_temperatures_in_another_unit_are_named(values, fits, cause):
    (found,) = temperature_fit.findings({name: np.array(x) for name, x in values.items()})
    assert found.fits is fits
    assert cause in found.text


def test_a_drive_that_sends_no_temperature_has_no_finding_of_them():
    assert temperature_fit.findings({}) == []
    (missing, rest) = temperature_fit.findings({"Tde": np.array([np.nan]), "Tnde": np.ones(3)})
    assert (missing.fits, rest.fits) == (None, True)


def test_crossed_commands_are_named_once_a_drive_has_obeyed_its_flag(tmp_path, capsys):
    """Drive 1 is flagged for half a second and gives way; each `Status` carries the other's."""
    bits, flags, sent = codec(), Flags(), []
    simulation = Simulation(scenario(**SCENARIO), bits)
    for now in range(TICK, round(4e9) + 1, TICK):
        lost = 2 if 1e9 <= now < 1.5e9 else 1
        sent += simulation.step([flags.frame(now, Adhesion1=lost, Adhesion2=1)], now)
    status = [bits.by_name[f"Drive{node}_Status"] for node in (1, 2)]
    other = {status[0].can_id: status[1], status[1].can_id: status[0]}
    wrong = []
    for frame in sent:
        if frame.can_id in other:
            spec, data = other[frame.can_id], bytearray(frame.data)
            protect(spec, data, frame.data[1] & 15)
            wrong.append(frame._replace(can_id=spec.can_id, data=bytes(data)))
        else:
            wrong.append(frame)
    text = "[[drive]]\nnode = 1\n[[drive]]\nnode = 2\n"
    code, lines = check(tmp_path, text, log_of(tmp_path / "r.log", sent), capsys)
    assert (code, [line for line in lines if "crossed" in line]) == (0, [])
    code, lines = check(tmp_path, text, log_of(tmp_path / "w.log", wrong), capsys)
    assert code == 2
    assert sum("are crossed" in line for line in lines) == 2, lines
