"""The command line as a user meets it: outputs, exit codes, one clear line for bad input."""

import csv
import errno
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from dbc.candump.reader import Reader
from dbc.codec import bind
from gateway.cli import main
from gateway.io.whole_file import whole, whole_folder
from gateway.settings.config import shipped_dbc

SCENARIO = """
title = "one loss"
seed = 5
duration_s = 2.0
drives = 3
[[event]]
at_s = 1.0
for_s = 0.5
drive = 2
kind = "adhesion_loss"
depth = 0.7
[[expect]]
flag = "adhesion"
is = "bad"
drive = 2
after_s = 1.0
within_ms = 60
[[expect]]
flag = "adhesion"
is = "bad"
drive = "others"
never = true
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scenario, its log and its truth."""
    here = tmp_path_factory.mktemp("cli")
    (here / "s.toml").write_text(SCENARIO)
    words = ["sim", str(here / "s.toml"), "-o", str(here / "s.log")]
    assert main([*words, "--truth", str(here / "truth.csv")]) == 0
    return here


def test_truth_has_a_row_per_drive_every_10_ms(folder):
    rows = list(csv.DictReader((folder / "truth.csv").read_text().splitlines()))
    assert list(rows[0]) == [
        "t_s", "drive", "speed_rad_s", "angle_rad", "load_nm", "lost", "fault_class",
        "true_effect_k",
        "cut",
        "creep",
        "train_speed_m_s",
    ]  # fmt: skip
    assert len(rows) == 3 * 200
    lost = {r["t_s"] for r in rows if r["lost"] == "1" and r["drive"] == "2"}
    assert 48 <= len(lost) <= 52


def test_replay_writes_flags_twice_the_same(folder, capsys):
    out = [folder / "a.log", folder / "b.log"]
    for path, more in zip(out, ([], ["--results", str(folder / "r")]), strict=True):
        assert main(["replay", str(folder / "s.log"), "-o", str(path), *more]) == 0
    assert out[0].read_bytes() == out[1].read_bytes()
    assert "AdhesionLost" in capsys.readouterr().out
    for name in ("flags.csv", "estimates.csv", "flags.svg", "drive2.svg"):
        assert (folder / "r" / name).stat().st_size > 1000
    flags = list(csv.DictReader((folder / "r" / "flags.csv").read_text().splitlines()))
    assert list(flags[0]) == [
        "t_s", "drive", "adhesion", "thermal", "reason", "adhesion_reason", "thermal_reason",
    ]  # fmt: skip
    for f in flags:
        assert (f["thermal"] == "Unknown") == (f["thermal_reason"] != "None")
        assert (f["adhesion"] == "Unknown") == (f["adhesion_reason"] != "None")
        assert (
            f["reason"]
            == f["thermal_reason" if f["adhesion_reason"] == "None" else "adhesion_reason"]
        )
    assert {"Starting", "None"} <= {f["adhesion_reason"] for f in flags}
    assert {f["thermal_reason"] for f in flags} == {"Starting", "Config"}
    assert {f["adhesion"] for f in flags if f["drive"] == "2"} == {
        "Unknown", "Adhering", "AdhesionLost",
    }  # fmt: skip
    assert flags[0]["reason"] == "Starting"


def test_replay_output_is_only_the_gateways_frames_on_the_logs_clock(folder):
    main(["replay", str(folder / "s.log"), "-o", str(folder / "c.log")])
    codec = bind(shipped_dbc("traction.dbc"), (1, 2, 3))
    first = next(iter(Reader(folder / "s.log"))).t_ns
    stamps = set()
    for frame in Reader(folder / "c.log", strict=True):
        assert codec.by_id[frame.can_id].is_gateway
        assert frame.channel == "vcan0"
        stamps.add(frame.t_ns)
    ticks = sorted((t - first) / 10_000_000 for t in stamps)
    assert ticks == list(range(len(ticks)))


def test_bad_input_is_one_clear_line(folder, refused, tmp_path):
    assert "no such file" in refused("replay", tmp_path / "none.log")
    empty = tmp_path / "empty.log"
    empty.write_text("")
    assert "no frame" in refused("replay", empty)
    bad = tmp_path / "bad.toml"
    bad.write_text("[loop]\nrate = 5\n")
    assert "loop.rate" in refused("replay", folder / "s.log", "--config", bad)
    bad.write_text("[drive]\nnode = 1\n")
    assert "drive: expected a list, got a table: write [[drive]]" in refused("check", bad)
    bad.write_text('[dbc]\nfile = "none.dbc"\n')
    assert "none.dbc" in refused("check", bad)
    bad.write_text('[dbc]\nfile = "broken.dbc"\n')
    (tmp_path / "broken.dbc").write_text("BO_ garbage")
    assert "broken.dbc" in refused("check", bad)
    log = folder / "s.log"
    assert "adhesion.detector" in refused("replay", log, "--detector", "wibble")
    bad.write_text('title = "x"\nduration_s = -1\nwrong = 2\n')
    said = refused("hil", bad)
    assert "duration_s" in said
    assert "wrong" in said
    assert "no_such" in refused("sim", "no_such")


def test_garbage_lines_are_counted_and_strict_stops(folder, capsys, refused, tmp_path):
    lines = (folder / "s.log").read_bytes().splitlines(keepends=True)
    lines[100:100] = [b"garbage\n", b"\x00\x00\x00\n", b"(1.0) vcan0 123#1\n"]
    dirty = tmp_path / "dirty.log"
    dirty.write_bytes(b"".join(lines) + b"(0000000002.1) vcan0 18")
    assert main(["replay", str(dirty)]) == 0
    out, err = capsys.readouterr()
    assert "malformed" in out
    assert "101" in err
    assert "101" in refused("replay", dirty, "--strict")


def test_several_channels_need_a_name(folder, refused, tmp_path):
    text = (folder / "s.log").read_text().splitlines()
    mixed = tmp_path / "mixed.log"
    mixed.write_text("\n".join([*text, text[-1].replace("vcan0", "can7")]) + "\n")
    assert "--log-channel" in refused("replay", mixed)
    assert main(["replay", str(mixed), "--log-channel", "vcan0"]) == 0


def test_hil_judges_and_writes_junit(folder, capsys, tmp_path):
    report = tmp_path / "r.xml"
    assert main(["hil", str(folder / "s.toml"), "--junit", str(report)]) == 0
    suite = ET.parse(report).getroot()[0]
    assert suite.get("tests") == "3"
    assert suite.get("failures") == "0"
    wrong = tmp_path / "w.toml"
    wrong.write_text(SCENARIO.replace('is = "bad"\ndrive = 2', 'is = "bad"\ndrive = 1', 1))
    assert main(["hil", str(wrong), "--junit", str(report)]) == 1
    assert ET.parse(report).getroot()[0].get("failures") == "1"
    assert "FAIL" in capsys.readouterr().out
    # Both have the same title.
    assert main(["hil", str(folder / "s.toml"), str(wrong), "--junit", str(report)]) == 1
    suites = ET.parse(report).getroot()
    cases = [(case.get("classname"), case.get("name")) for case in suites.iter("testcase")]
    assert len(set(cases)) == len(cases) == 6
    assert [suite.get("failures") for suite in suites] == ["0", "1"]
    # What the schema of Jenkins (junit-10.xsd) requires.
    assert all({"name", "tests", "failures", "errors"} <= set(suite.keys()) for suite in suites)
    assert {part.tag for case in suites.iter("testcase") for part in case} <= {
        "system-out", "failure", "error"
    }  # fmt: skip


def test_a_report_of_the_timing_needs_a_folder(capsys, refused, tmp_path):
    results, file = tmp_path / "r", tmp_path / "file"
    file.write_text("")
    bus = ("-i", "virtual", "-c", "timing")
    assert str(file) in refused("run", *bus, "--results", file)
    words = ["run", *bus, "--quiet", "--duration", "0.05", "--results", str(results)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert f"report: {results / 'report.html'}" in said
    assert "frame to flag not measured: no sample came" in said
    assert "lateness" in (results / "timing.csv").read_text()


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("", "after 3 received periods of silence, at least 300 ms"),
        (
            "[canopen]\nheartbeat_ms = 1000\n",
            "every 1000 ms: from its second heartbeat on, a node is lost after 3000 ms of silence",
        ),
        ("[canopen]\nheartbeat_ms = 50\n", "after 300 ms of silence"),
    ],
)
def test_check_says_what_it_expects_of_heartbeats(capsys, tmp_path, section, expected):
    path = tmp_path / "train.toml"
    path.write_text(section)
    assert main(["check", str(path), "--no-timing"]) == 0
    (line,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("heartbeats "))
    assert expected in line


def test_check_knows_the_bus_load_of_the_contract(capsys, tmp_path):
    path = tmp_path / "t.toml"

    def text(n):
        return "".join(f"[[drive]]\nnode = {k}\n" for k in range(1, n + 1))

    path.write_text(text(4))
    assert main(["check", str(path), "--no-timing"]) == 0
    assert "65 %" in capsys.readouterr().out
    path.write_text(text(6))
    assert main(["check", str(path), "--no-timing"]) == 2
    out, err = capsys.readouterr()
    assert "97 %" in out
    assert "above 80 %" in err


@pytest.mark.parametrize(("text", "told"), [("", 1), ("[[drive]]\nnode = 1\n", 0)])
def test_check_says_which_drives_are_assumed(capsys, tmp_path, text, told):
    path = tmp_path / "t.toml"
    path.write_text(text)
    assert main(["check", str(path), "--no-timing"]) == 0
    out = capsys.readouterr().out
    assert out.count("no [[drive]] in it: drives 1, 2, 3 with motor bench") == told


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """A minute of slow messages without a fault: the lines of its log."""
    here = tmp_path_factory.mktemp("healthy")
    (here / "h.toml").write_text(
        'title = "h"\nseed = 3\nduration_s = 61\ndrives = 3\ntraffic = "slow"\n'
    )
    assert main(["sim", str(here / "h.toml"), "-o", str(here / "h.log")]) == 0
    return (here / "h.log").read_text().splitlines(keepends=True)


def test_calibrate_then_replay_knows_thermal(healthy, capsys, refused, tmp_path):
    log = tmp_path / "h.log"
    log.write_text("".join(healthy[: len(healthy) // 2]))
    cells = tmp_path / "cells.toml"
    said = refused("calibrate", log, "-o", cells)
    assert "at least 300 s are needed (of a single log, 70%" in said, "too short for a model"
    assert not cells.exists()
    assert main(["calibrate", str(log), "-o", str(cells), "--without-model"]) == 0
    config = tmp_path / "c.toml"
    config.write_text(f'[thermal]\ncalibration = "{cells.name}"\n')
    printed = capsys.readouterr()
    assert "no thermal model because all values are known for" in printed.out
    found = re.search(
        r"warning: the limits come from (\d+) s of temperatures, 300 s needed", printed.err
    )
    assert found
    assert 25 <= int(found[1]) <= 30
    assert "no thermal model" in refused("replay", log, "--config", config)
    config.write_text(f'[thermal]\ncalibration = "{cells.name}"\nmethod = "maisd"\n')
    assert main(["replay", str(log), "--config", str(config)]) == 0
    out = capsys.readouterr().out
    assert out.count("thermal   NoFault") == 3
    assert " Fault" not in out


@pytest.mark.parametrize("to", [("-o", "x.toml", "--without-model"), ("--adhesion",)])
def test_a_calibration_from_a_damaged_log_is_exit_1(healthy, capsys, tmp_path, monkeypatch, to):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "h.log").write_text("".join(healthy))
    assert main(["calibrate", "h.log", *to]) == 0
    cut = [line[:20] + "\n" if k % 20 == 7 else line for k, line in enumerate(healthy)]
    (tmp_path / "h.log").write_text("".join(cut))
    assert main(["calibrate", "h.log", *to]) == 1
    assert "5.0 % of the input was dropped, which is more than 1%: malformed" in (
        capsys.readouterr().err
    )


def test_help_and_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("traction-gateway 0.")
    assert main([]) == 2
    with pytest.raises(SystemExit) as stop:
        main(["replay", "--help"])
    assert stop.value.code == 0


def test_outputs_that_cannot_be_are_one_line(folder, refused, tmp_path):
    log = folder / "s.log"
    size = log.stat().st_size
    assert "is the file of `log` too" in refused("replay", log, "-o", log)
    assert log.stat().st_size == size
    assert "/dev/full: No space left on device" in refused("replay", log, "-o", "/dev/full")
    folder_named = f"{tmp_path}: is a folder; name a file"
    assert folder_named in refused("replay", log, "-o", tmp_path)
    assert folder_named in refused("hil", folder / "s.toml", "--junit", tmp_path)
    none = tmp_path / "none.csv"
    truth = refused("replay", log, "--truth", none, "--results", tmp_path / "r")
    assert f"{none}: no such file or folder" in truth
    assert "cannot be read: Is a directory" in refused("replay", log, "--config", tmp_path)
    refused("replay", log, "-o", log / "x.log")
    refused("replay", log, "--results", log)
    assert "folder" in refused("replay", tmp_path)


@pytest.mark.parametrize(
    ("words", "written", "other"),
    [
        (("hil", "s.toml", "-o", "s.toml"), "output", "scenario"),
        (("hil", "s.toml", "--junit", "./s.toml"), "junit", "scenario"),
        (("hil", "s.toml", "--junit", "new", "-o", "new"), "output", "junit"),
        (("sim", "s.toml", "-o", "s.toml"), "output", "scenario"),
        (("sim", "s.toml", "-o", "new", "--truth", "new"), "output", "truth"),
        (("replay", "s.log", "-o", "truth.csv", "--truth", "truth.csv"), "output", "truth"),
        (("calibrate", "truth.csv", "s.log", "-o", "s.log"), "output", "log"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_is_read_is_not_overwritten(folder, refused, monkeypatch, words, written, other):
    monkeypatch.chdir(folder)
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    said = refused(*words)
    assert f"is the file of `{other}` too; name another one for `{written}`" in said
    assert {path: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--expect-noticed", "90"), "--expect-noticed: only with --mutate"),
        (("--mutate-seed", "3"), "--mutate-seed: only with --mutate"),
        (("--expect-score", "50"), "--expect-score: only with --slip-bench"),
        (("--controller", "creep"), "--controller: only with --slip-bench"),
        (("--mutate", "3", "--junit", "x.xml"), "--junit: not with --mutate"),
        (("--slip-bench", "--results", "x"), "--results: not with --slip-bench"),
    ],
    ids=str,
)
def test_an_option_of_hil_that_would_have_no_effect_is_refused(folder, refused, words, said):
    assert said in refused("hil", folder / "s.toml", *words)


@pytest.mark.parametrize("option", ["--expect-noticed", "--expect-score"])
@pytest.mark.parametrize("share", ["nan", "-1", "101", "many"])
def test_a_least_share_is_a_percentage(folder, capsys, option, share):
    mode = {"--expect-noticed": ["--mutate", "1"], "--expect-score": ["--slip-bench"]}[option]
    with pytest.raises(SystemExit) as stop:
        main(["hil", str(folder / "s.toml"), *mode, f"{option}={share}"])
    assert stop.value.code == 2
    assert f"'{share}' is not a percentage: expected 0 to 100" in capsys.readouterr().err


def test_a_configuration_with_too_few_drives_for_a_scenario_is_refused(folder, refused, tmp_path):
    one = tmp_path / "one.toml"
    one.write_text("[[drive]]\nnode = 9\n")
    said = refused("hil", folder / "s.toml", "--config", one)
    assert "the scenario has 3 drives, [[drive]] names 1: add the others" in said


def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    folder, refused, tmp_path, capsys
):
    for words in (["hil", folder / "s.toml", "--junit"], ["calibrate", folder / "s.log", "-o"]):
        assert f"{tmp_path}: is a folder; name a file" in refused(*words, tmp_path)
        assert not capsys.readouterr().out


def test_an_error_names_the_users_file_and_not_the_incomplete_one(tmp_path):
    for make, name in ((whole, "a.log"), (whole_folder, "results/a.log")):
        path = tmp_path / Path(name).parts[0]

        def write(make=make, path=path):
            with make(path) as part:
                raise OSError(
                    errno.EROFS, "Read-only", str(part if make is whole else part / "a.log")
                )

        with pytest.raises(OSError, match="Read-only") as raised:
            write()
        assert raised.value.filename == str(tmp_path / name)


def test_a_dbc_in_place_of_a_configuration_and_a_log_without_frames_are_named(refused, tmp_path):
    dbc, log = tmp_path / "a.dbc", tmp_path / "none.log"
    dbc.write_text('VERSION "1.0"\n')
    log.write_text("")
    assert "this is a DBC: name a configuration" in refused("check", dbc)
    assert f"{log}: no frame in the log" in refused("replay", log)


def test_an_option_given_twice_is_refused(folder, capsys):
    with pytest.raises(SystemExit):
        main(["replay", str(folder / "s.log"), "--detector", "vb", "--detector", "median"])
    assert "argument --detector: given twice; give it once" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "said"), [("/dev/full", "File exists"), ("/dev/full/r", "is not a folder")]
)
def test_a_folder_that_is_a_file_is_one_line(folder, refused, name, said):
    assert f"{name}: {said}; name another one" in refused(
        "replay", folder / "s.log", "--results", name
    )


def test_a_log_with_cr_line_ends_is_refused_with_the_cure(folder, refused, tmp_path):
    path = tmp_path / "cr.log"
    path.write_bytes((folder / "s.log").read_bytes().replace(b"\n", b"\r"))
    assert "lines end in CR only; change them with `tr" in refused("replay", path)


def test_of_several_logs_the_one_without_frames_is_named(folder, refused, tmp_path):
    (tmp_path / "none.log").write_text("")
    words = ["calibrate", folder / "s.log", tmp_path / "none.log", "-o", tmp_path / "c.toml"]
    assert "none.log: no frame in the log" in refused(*words)


@pytest.mark.parametrize("text", ["nan", "inf", "-1", "0", "soon"])
def test_a_duration_is_a_finite_time(text, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["sim", "healthy", f"--duration={text}"])
    assert stop.value.code == 2
    assert "not a duration" in capsys.readouterr().err


def test_a_log_may_have_any_name(folder, capsys, tmp_path):
    odd = tmp_path / "recording"
    odd.write_bytes((folder / "s.log").read_bytes())
    assert main(["replay", str(odd)]) == 0
    assert "AdhesionLost" in capsys.readouterr().out


def test_much_that_is_dropped_is_a_warning_and_exit_1(folder, capsys, tmp_path):
    """Of every cause: lines that are none, stamps that go back."""
    lines = (folder / "s.log").read_text().splitlines()
    assert len(lines) > 2000
    stray = [f"(0.000001) {line.split(' ', 1)[1]}" for line in lines]

    def with_odd(name, odd, share):
        """After every so many lines an odd one."""
        path, every, text = tmp_path / name, round(1 / share), []
        for k, line in enumerate(lines):
            text += [line, odd[k]] if k % every == every - 1 else [line]
        path.write_text("\n".join(text) + "\n")
        return path

    noise = ["no line of a log"] * len(lines)
    for name, odd, cause in (("noise", noise, "malformed"), ("back", stray, "time_back")):
        few, many = with_odd(f"{name}.few.log", odd, 0.005), with_odd(f"{name}.log", odd, 0.03)
        assert main(["replay", str(few)]) == 0
        assert "was dropped" not in capsys.readouterr().err
        assert main(["replay", str(many)]) == 1
        out, err = capsys.readouterr()
        assert "2.9 % of the input was dropped, which is more than 1%" in err
        assert f"{cause} {len(lines) // 33}" in err
        assert "AdhesionLost" in out, "what is there is judged all the same"
        lost = 1 if cause == "malformed" else 0
        assert main(["convert", str(many), str(tmp_path / "o.csv")]) == lost
        assert ("was dropped" in capsys.readouterr().err) == bool(lost)
        assert main(["convert", str(few), str(tmp_path / "o.csv")]) == 0
        capsys.readouterr()


def test_a_clock_that_was_set_back_is_told(folder, capsys, tmp_path):
    lines = (folder / "s.log").read_text().splitlines()
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    half = len(lines) // 2
    rest = [
        f"({t + 5000 - 3600:.6f}){line[line.index(')') + 1 :]}"
        for t, line in zip(stamps[half:], lines[half:], strict=True)
    ]
    first = [f"({t + 5000:.6f}){line[line.index(')') + 1 :]}"
             for t, line in zip(stamps[:half], lines[:half], strict=True)]  # fmt: skip
    path = tmp_path / "set.log"
    path.write_text("\n".join([*first, *rest]) + "\n")
    assert main(["replay", str(path), "-o", str(tmp_path / "o.log")]) == 0
    out, err = capsys.readouterr()
    assert "set back by 3600" in err.replace("3599.99", "3600")
    assert "time_back" not in out
    sent = [
        float(line[1 : line.index(")")])
        for line in (tmp_path / "o.log").read_text().split("\n")
        if line
    ]
    assert sent[0] == pytest.approx(5000 + stamps[0], abs=0.02)
    assert sent[-1] == pytest.approx(5000 - 3600 + stamps[-1], abs=0.02)
