"""Logs that are no files, and names and titles with what a terminal or a parser would obey."""

import io
import logging
import os
import pty
import re
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest

from gateway.cli import main
from gateway.io.log_setup import begin

ESCAPE = "\x1b[2J\x1b]0;owned\x07"
"""Clears a screen and names its window."""
SHOWN = r"wet\x1b[2J\x1b]0;owned\x07\x9b2J\x00\nrail [/red]"
SCENARIO = """
title = "wet\\u001b[2J\\u001b]0;owned\\u0007\\u009b2J\\u0000\\nrail [/red]"
duration_s = 0.8
drives = 1
[[expect]]
flag = "adhesion"
is = "bad"
after_s = 0.1
never = true
"""
LINES = b"(1.000000) can\xc2\x9b[/x] 181#0011223344556677\n" * 3
CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")


def harmless(text):
    """No control character but the line end."""
    assert CONTROL.search(text) is None, repr(text)


# ---- logs that are no files --------------------------------------------------------------------


@pytest.fixture(params=["fifo", "zero", "null", "socket"])
def no_file(request, tmp_path):
    """In a folder of its own, under the name of a log."""
    path = tmp_path / "a.log"
    if request.param == "fifo":
        os.mkfifo(path)
    elif request.param == "socket":
        import socket

        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(path))
    else:
        path.symlink_to(f"/dev/{request.param}")
    return path


@pytest.mark.parametrize(
    "words",
    [
        ["check", "{}"],
        ["sim", "{}", "-o", "out.log"],
        ["hil", "{}"],
        ["replay", "a", "--config", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_a_device_without_an_end_is_no_configuration(words, tmp_path, refused):
    endless = tmp_path / "endless.toml"
    endless.symlink_to("/dev/zero")
    assert "larger than 64 MiB" in refused(*[word.format(endless) for word in words])


def test_a_dbc_without_an_end_is_refused(tmp_path, refused):
    (tmp_path / "endless.dbc").symlink_to("/dev/zero")
    (tmp_path / "train.toml").write_text('dbc = {file = "endless.dbc"}\ndrive = [{node = 1}]\n')
    assert "larger than 64 MiB" in refused("check", tmp_path / "train.toml")


@pytest.mark.timeout(600)  # who opens a FIFO that nobody writes to waits for ever
@pytest.mark.parametrize("verb", ["replay", "convert", "calibrate", "monitor"])
def test_what_is_no_file_is_refused_in_words(verb, no_file, tmp_path, capsys):
    words = {
        "replay": ["replay", no_file], "convert": ["convert", no_file, tmp_path / "out.csv"],
        "calibrate": ["calibrate", no_file, "-o", tmp_path / "out.toml"],
        "monitor": ["monitor", no_file, "--web", "127.0.0.1:0"],
    }[verb]  # fmt: skip
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said == f"traction-gateway: {no_file}: a FIFO, device or socket, not a log; " + (
        "write a file first"
    )
    assert not list(tmp_path.glob("out.*"))


@pytest.mark.timeout(600)
@pytest.mark.parametrize("ending", ["asc", "blf", "parquet", "mf4", "log.gz"])
def test_whatever_its_name_ends_with(ending, tmp_path, refused):
    path = tmp_path / f"a.{ending}"
    os.mkfifo(path)
    assert "a FIFO, device or socket" in refused("convert", path, tmp_path / "out.csv")


# ---- titles and names --------------------------------------------------------------------------


def test_a_title_is_shown_as_text_in_terminal_html_and_junit(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(SCENARIO)
    junit, results = tmp_path / "j.xml", tmp_path / "results"
    words = ["hil", str(tmp_path / "s.toml"), "--junit", str(junit), "--results", str(results)]
    assert main(words) == 0
    said = capsys.readouterr()
    harmless(said.out + said.err)
    assert SHOWN in said.out
    (suite,) = ET.parse(junit).iter("testsuite")
    assert suite.get("name") == SHOWN
    whole = (results / "report.html").read_text(encoding="utf-8")
    harmless(whole + (results / "report.md").read_text(encoding="utf-8"))
    assert f"<title>{SHOWN}</title>" in whole


def test_a_title_on_a_real_terminal(tmp_path):
    """There a bar is drawn beside it, whose markup a title has none of."""
    (tmp_path / "s.toml").write_text(SCENARIO)
    inner, outer = pty.openpty()
    done = subprocess.run([sys.executable, "-m", "gateway", "hil", str(tmp_path / "s.toml")],
                          stdout=subprocess.PIPE, stderr=outer, text=True, check=False)  # fmt: skip
    os.close(outer)
    drawn = os.read(inner, 1 << 20).decode()
    os.close(inner)
    assert done.returncode == 0, drawn
    assert ESCAPE not in drawn
    assert "\x1b]0" not in drawn
    harmless(done.stdout)


@pytest.mark.parametrize("verb", ["replay", "check", "convert", "calibrate", "hil"])
def test_names_in_a_refusal_are_text(verb, tmp_path, capsys):
    path = tmp_path / f"a{ESCAPE}.toml"
    path.write_text("not = 'ours'\n")
    more = {"convert": [str(tmp_path / "out.csv")], "calibrate": ["-o", str(tmp_path / "c.toml")]}
    assert main([verb, str(path), *more.get(verb, [])]) == 2
    said = capsys.readouterr()
    harmless(said.out + said.err)
    assert r"\x1b[2J" in said.err


def test_channels_of_a_log_are_text(tmp_path, capsys):
    """A C1 control character is no blank, and `[/x]` is markup to who draws."""
    (tmp_path / "a.log").write_bytes(LINES)
    assert main(["replay", str(tmp_path / "a.log")]) == 0
    said = capsys.readouterr()
    harmless(said.out + said.err)
    assert r"can\x9b[/x]" in "".join(said.err.split("\n"))


def test_a_line_of_the_log_stays_one(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(logging, "root", logging.RootLogger(logging.WARNING))
    begin(logging.WARNING)
    logging.root.warning("link %s is down", f"can0{ESCAPE}\nERROR forged")
    harmless(stream.getvalue())
    assert stream.getvalue().count("\n") == 1
