"""A signal that is not available takes no other signal of its message with it."""

import math
from collections import Counter

import pytest

from dbc.frame import Frame
from dbc.frames import block_of
from gateway.cli import main
from gateway.core.gateway import Gateway
from gateway.mapping.plan import fitted, plans
from gateway.mapping.translate import Translator
from gateway.settings.config import parse
from tests.inverters import write_dbc
from tests.sender import MS, Sender, codec_for

KNOWN = {
    "Status": {"Irms": 70.0, "TorqueCommand": 20.0, "State": 2, "FaultCode": 0},
    "Motion": {"Speed": 1000.0, "Torque": 20.0, "ElectricalAngle": 10.0},
}


def drive_of(kind, values):
    """What is kept of drive 1 after 29 ticks, of which each has one message: values(k)."""
    codec = codec_for()
    gateway = Gateway(parse({"drive": [{"node": n} for n in (1, 2, 3)]}), codec, 0)
    sender = Sender(codec, f"Drive1_{kind}")
    for k in range(1, 30):
        gateway.step([sender.frame(10 * k * MS, **values(k))], 10 * k * MS)
    return gateway.inbox.receiver.drives[0]


def received(kind, without):
    """Speed, current and command of drive 1, NaN where none is known."""
    drive = drive_of(kind, lambda k: {**KNOWN[kind], without: None})
    return float(drive["speed"]), float(drive["irms"]), float(drive["command"])


@pytest.mark.parametrize("without", ["FaultCode", "State", "Irms", "TorqueCommand"])
def test_status(without):
    nan = math.nan
    _, irms, command = received("Status", without)
    assert irms == pytest.approx(nan if without == "Irms" else 70.0, nan_ok=True)
    assert command == pytest.approx(nan if without == "TorqueCommand" else 20.0, nan_ok=True)


def test_a_status_without_command_and_current_says_nothing():
    nothing = {"Irms": None, "TorqueCommand": None, "State": 2}
    drive = drive_of("Status", lambda k: KNOWN["Status"] if k < 20 else nothing)
    assert (drive["irms"], drive["command"]) == (pytest.approx(70.0), pytest.approx(20.0))
    assert drive["command_ns"] == 190 * MS, "the last that said something"


@pytest.mark.parametrize("without", ["Torque", "ElectricalAngle", "Speed"])
def test_motion(without):
    speed, *_ = received("Motion", without)
    expected = math.nan if without == "Speed" else 104.72
    assert speed == pytest.approx(expected, abs=0.1, nan_ok=True)


# ---- ends of raw ranges of mapped temperatures ---------------------------------------------------


def temperatures(folder, raw):
    """What becomes of the readings of an 8-bit sensor, -40 to 215 degC."""
    file = {"Tmp": (0x600, 100, ['Motor : 0|8@1+ (1,-40) [-40|215] "degC"',
                                 'Bearing : 8|8@1+ (1,-40) [-40|215] "degC"'])}  # fmt: skip
    write_dbc(folder / "one.dbc", file)
    use = {"Tstator": "Tmp.Motor", "Tde": "Tmp.Bearing"}
    config = parse({"drive": [{"node": 1, "signals": {"dbc": "one.dbc", "use": use}}]}, base=folder)
    codec = fitted(codec_for((1,)), plans(config))
    translator = Translator(plans(config), codec)
    found = []
    for k, value in enumerate(raw, 1):
        t_ns = k * 100 * MS
        frame = Frame(t_ns, 0x600, bytes([value, 90, *bytes(6)]))
        counts = Counter()
        (made,) = translator.translate(block_of([frame]), t_ns, counts).frames()
        spec = codec.by_name["Drive1_Temperatures"]
        read = codec.decode(spec, made.data)
        assert read["Tde"].value == pytest.approx(50.0)
        found.append(round(read["Tstator"].value) if read["Tstator"].validity == 0 else None)
    return found


def test_a_sensor_that_jumps_to_an_end_has_no_value(tmp_path):
    assert temperatures(tmp_path, [100, 255, 101, 0, 100]) == [60, None, 61, None, 60]
    assert temperatures(tmp_path, [255, 255, 0, 100]) == [None, None, None, 60]


def test_a_motor_that_warms_up_to_the_end_is_believed(tmp_path):
    assert temperatures(tmp_path, [248, 252, 254, 255, 255]) == [208, 212, 214, 215, 215]


def test_check_proposes_codes_where_nothing_says_them(tmp_path, capsys):
    temperatures(tmp_path, [100])
    text = '[[drive]]\nnode = 1\n[drive.signals]\ndbc = "one.dbc"\n[drive.signals.use]\n'
    path = tmp_path / "train.toml"
    motor = '{ signal = "Tmp.Motor", scale = 0.5 }'
    path.write_text(text + f'Tstator = {motor}\nTde = "Tmp.Bearing"\nTnde = "Tmp.Bearing"\n')
    main(["check", str(path), "--no-timing"])
    printed = capsys.readouterr().out
    assert "Tstator: raw 0 (-20), 255 (107.5) may mean that there is no value" in printed
    assert "Tde, Tnde: raw 0 (-40), 255 (215) may mean that there is no value" in printed
    named = '{ signal = "Tmp.Motor", scale = 0.5, not_available = [0, 255] }'
    assert f"Tstator = {named}" in printed
    path.write_text(text + f'Tstator = {named}\nTde = "Tmp.Bearing"\n')
    main(["check", str(path), "--no-timing"])
    assert "Tstator: raw" not in capsys.readouterr().out


def test_drives_share_their_lines_only_if_they_share_a_dbc(tmp_path, capsys):
    temperatures(tmp_path, [100])
    (tmp_path / "two.dbc").write_text((tmp_path / "one.dbc").read_text())
    drives = [
        f'[[drive]]\nnode = {node}\n[drive.signals]\ndbc = "{dbc}.dbc"\nid_offset = {16 * node}\n'
        '[drive.signals.use]\nTstator = "Tmp.Motor"\n'
        for node, dbc in ((1, "one"), (2, "two"), (3, "one"))
    ]
    path = tmp_path / "train.toml"
    path.write_text("".join(drives))
    main(["check", str(path), "--no-timing"])
    printed = capsys.readouterr().out
    assert "drives 1, 3    one.dbc, identifiers moved by 0x10, 0x30\n" in printed
    assert "drive 2        two.dbc, identifiers moved by 0x20\n" in printed
