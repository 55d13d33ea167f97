"""Configuration: validated whole, refused with every problem and its path."""

import pytest

from gateway.mapping.plan import plans
from gateway.settings.calibration import Calibration, MotorCalibration, to_toml
from gateway.settings.calibration import load as load_calibration
from gateway.settings.config import Config, ConfigError, load, parse, shipped_dbc


def problems(raw):
    with pytest.raises(ConfigError) as caught:
        parse(raw)
    return caught.value.problems


def test_default_is_three_bench_drives():
    config = load(None)
    assert config.nodes == (1, 2, 3)
    assert config.motors["bench"].pole_pairs == 4
    assert config.loop.period_ns == 10_000_000
    assert not config.canopen.nmt_master


def test_every_problem_is_listed_with_its_path():
    found = problems(
        {
            "loop": {"rate_hz": 300},
            "adhesion": {"detektor": "vb", "detector": "guess"},
            "drive": [{"node": 17}, {"node": 2, "motr": "x"}],
        }
    )
    text = "\n".join(found)
    for path in ("loop", "adhesion.detektor", "adhesion.detector", "drive.0.node", "drive.1.motr"):
        assert path in text
    assert "unknown key" in text
    assert len(found) == 5


@pytest.mark.parametrize(
    ("raw", "meant"),
    [
        ({"drive": [{"nod": 1}]}, "drive.0.nod: unknown key; did you mean 'node'?"),
        ({"drve": []}, "drve: unknown key; did you mean 'drive'?"),
        ({"motor": {"m": {"R_S": 1}}}, "motor.m.R_S: unknown key; did you mean 'R_s'?"),
        ({"thermal": {"limt_k": 1}}, "thermal.limt_k: unknown key; did you mean 'limit_k'?"),
        ({"loop": {"xyz": 1}}, "loop.xyz: unknown key; remove it or correct its name"),
    ],
)
def test_the_key_that_was_meant_is_named(raw, meant):
    assert meant in problems(raw)


def test_a_problem_has_the_line_of_its_key(tmp_path):
    path = tmp_path / "train.toml"
    path.write_text(
        "[loop]\n# nothing\nrate_hz = 300\n\n[[drive]]\nnode = 1\n[[drive]]\nnode = 2\n"
        'moter = "bench"\n\n[motor.mine]\nR_s = 1\n'
    )
    with pytest.raises(ConfigError) as refused:
        load(path)
    text = str(refused.value)
    assert text.startswith(f"{path}: ")
    assert "line 3: loop.rate_hz: " in text
    assert "line 9: drive.1.moter: unknown key; did you mean 'motor'?" in text
    assert "line 11: motor.mine.L_s: expected, but missing" in text


def test_a_mapping_that_does_not_fit_its_dbc_has_file_and_line(tmp_path):
    path = tmp_path / "train.toml"
    path.write_text(
        f'[[drive]]\nnode = 1\n[drive.signals]\ndbc = "{shipped_dbc("traction.dbc")}"\n'
        '[drive.signals.use]\nSpeed = "Drive1_Motion.Sped"\n'
    )
    with pytest.raises(
        ConfigError, match=r"line 6: drive.0.signals.use.Speed: .* no signal 'Sped'"
    ) as refused:
        plans(load(path))
    assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "cure"),
    [
        ("[loop]\n".encode("utf-16"), "UTF-16, .*; save it as UTF-8"),
        (b"[loop]\nrate_hz = 100\n# \xe9\n", "line 3: byte 0xe9 is no UTF-8; save it as UTF-8"),
        (b"[loop]\rrate_hz = 100\r", "lines end in CR only; save it with LF"),
    ],
)
def test_another_encoding_is_refused_with_its_cure(content, cure, tmp_path):
    path = tmp_path / "train.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=cure):
        load(path)


def test_a_mark_before_utf_8_is_read(tmp_path):
    path = tmp_path / "train.toml"
    path.write_bytes(b"\xef\xbb\xbf[loop]\r\nrate_hz = 200\r\n")
    assert load(path).loop.rate_hz == 200


def test_consistency_is_checked_across_sections():
    found = problems(
        {"drive": [{"node": 1}, {"node": 1, "motor": "big"}], "adhesion": {"observe": "speed"}}
    )
    text = "\n".join(found)
    assert "node 1 is used twice" in text
    assert "no [motor.big]" in text
    assert "adhesion.observe" in text


@pytest.mark.parametrize("rate", [100, 200, 500, 1000])
def test_rates_of_the_contract(rate):
    assert parse({"loop": {"rate_hz": rate}}).loop.period_ns == 1_000_000_000 // rate


def test_missing_and_broken_files_are_one_clear_error(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[bus\n")
    with pytest.raises(ConfigError, match="TOML"):
        load(broken)
    broken.write_text("base = 'x'\n")
    with pytest.raises(ConfigError, match="unknown key"):
        load(broken)


def test_only_the_papers_vb_observes_speed():
    for name in ("paper_vb", "paper_vb_reuse"):
        assert parse({"adhesion": {"detector": name, "observe": "both"}}).adhesion.observe == "both"
    with pytest.raises(
        ConfigError, match=r"adhesion.observe: detector 'switching' compares torque only"
    ):
        parse({"adhesion": {"observe": "speed"}})


@pytest.mark.parametrize("key", ["tolerance", "reuse"])
def test_only_the_papers_vb_has_a_bound_and_reuses(key):
    assert getattr(parse({"adhesion": {"detector": "paper_vb", key: 0.5}}).adhesion, key) == 0.5
    with pytest.raises(ConfigError, match=f"adhesion.{key}: detector 'switching' has no such key"):
        parse({"adhesion": {key: 0.5}})
    with pytest.raises(ConfigError, match=f"adhesion.{key}"):
        parse({"adhesion": {"detector": "paper_vb", key: -0.5}})


def test_example_is_the_default_written_out(pytestconfig):
    example = load(pytestconfig.rootpath / "examples" / "train.toml")
    bare = Config(motor={"bench": example.motor["bench"]})
    assert example.model_dump(exclude={"base"}) == bare.model_dump(exclude={"base"})


def test_hash_names_the_configuration():
    a, b = load(None), parse({"adhesion": {"raise_ms": 30}})
    assert a.hash24() == load(None).hash24() != b.hash24()
    assert 0 <= a.hash24() < 1 << 24


CELLS = Calibration(
    window_s=5.0,
    maisd_limit_k=(0.5, 0.4, 0.4),
    deviation_limit_k=(1.0, 0.9, 0.9),
    motor=(
        MotorCalibration(
            node=1,
            gain=(1, 1, 1.03),
            offset_k=(0.1, 0.0, -0.1),
            longest_hold_s=(1, 1, 1),
            largest_step_k=(1, 1, 1),
        ),
    ),
)


def test_calibration_round_trip_and_mismatches(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(to_toml(CELLS))
    assert load_calibration(path, (1,), 5.0) == CELLS
    with pytest.raises(ConfigError, match=r"node 2 .*not calibrated.*; line \d: window_s"):
        load_calibration(path, (1, 2), 4.0)
    path.write_text("window_s = 5\nextra = 1\n")
    with pytest.raises(ConfigError, match="extra"):
        load_calibration(path, (1,), 5.0)
    with pytest.raises(ConfigError, match="traction-gateway calibrate"):
        load_calibration(tmp_path / "none.toml", (1,), 5.0)


def test_a_drive_has_all_sensors_unless_told_which():
    some = parse({"drive": [{"node": 1}, {"node": 2, "sensors": ["stator", "drive_end"]}]})
    assert some.drive[0].sensors == ("stator", "drive_end", "non_drive_end")
    assert some.drive[1].sensors == ("stator", "drive_end")


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        ([], "drive.0.sensors: at least one is needed"),
        (["stator", "stator"], "drive.0.sensors: stator is listed twice"),
        (["winding"], "drive.0.sensors.0: expected 'stator', 'drive_end' or"),
    ],
)
def test_sensors_are_refused_in_one_line(sensors, said):
    (line,) = problems({"drive": [{"node": 1, "sensors": sensors}]})
    assert line.startswith(said)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.500, 0.400", "0.500, 1e6", "maisd_limit_k.1: expected 0.01 to 100 K, got 1000000.0"),
        ("1.000, 0.900", "0.0, 0.900", "deviation_limit_k.0: expected 0.01 to 100 K, got 0.0"),
        ("gain = [1.000", "gain = [0.0", "motor.0.gain.0: expected 0.01 to 100, got 0.0"),
        ("window_s = 5.0", "window_s = 1e13", "window_s: expected 0.1 to 3600 s"),
    ],
)
def test_a_calibration_by_which_no_fault_is_ever_told_is_refused(old, new, said, tmp_path):
    path = tmp_path / "c.toml"
    text = to_toml(CELLS)
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as refused:
        load_calibration(path, (1,), 5.0)
    (line,) = refused.value.problems
    lines = path.read_text().splitlines()
    number = next(k for k, text in enumerate(lines, 1) if new in text)
    assert line.startswith(f"line {number}: {said}")
