"""Ctrl-C before a command is ready, and before its results are complete."""

import signal
import subprocess
import sys

import pytest

from gateway.cli import main
from gateway.io.endings import Ended
from gateway.io.whole_file import whole_folder

IMPORTED = """
import os, sys, time
sys.argv = [{name!r}]
import gateway
os.kill(os.getpid(), 2)
time.sleep(5)
"""

STARTING = """
import multiprocessing, os, sys, threading, time

def interrupt():
    while not multiprocessing.active_children():
        time.sleep(0.01)
    os.kill(os.getpid(), 2)

if __name__ == "__main__":
    from gateway.cli import main
    threading.Thread(target=interrupt, daemon=True).start()
    sys.exit(main(["fleet", sys.argv[1], "-o", sys.argv[2], "-j", "2"]))
"""
"""A fleet that is interrupted while its processes start. A file, because they import it, too."""


def imported_as(name):
    words = [sys.executable, "-c", IMPORTED.format(name=name)]
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("name", ["/usr/bin/traction-gateway", "-m"])
def test_the_program_ends_without_a_traceback_from_its_first_import_on(name):
    done = imported_as(name)
    assert (done.returncode, done.stderr) == (130, "")


def test_a_program_that_imports_the_package_keeps_its_own_handling():
    done = imported_as("notebook.py")
    assert done.returncode != 130
    assert "KeyboardInterrupt" in done.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_run_that_is_stopped_before_it_has_its_bus(monkeypatch, caplog, number, code):
    def stopped(_options):
        raise Ended(number)

    monkeypatch.setattr("gateway.commands.run._start", stopped)
    assert main(["run", "-i", "virtual", "-c", "x"]) == code
    assert "stopped before the bus was used" in caplog.text


@pytest.fixture
def log(tmp_path):
    assert main(["sim", "release", "-o", str(tmp_path / "a.log"), "--duration", "1"]) == 0
    return str(tmp_path / "a.log")


def test_a_fleet_whose_processes_are_starting_ends_without_a_traceback(tmp_path, log):
    program = tmp_path / "starting.py"
    program.write_text(STARTING)
    words = [sys.executable, str(program), log, str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert "run the same command again to continue" in done.stderr


def interrupted(*_args, **_more):
    raise Ended(signal.SIGINT)


@pytest.mark.parametrize("where", ["reporting.run_figures.draw", "run_report.page.write"])
def test_no_results_are_left_of_a_run_that_has_no_report(tmp_path, monkeypatch, log, where):
    scenario = tmp_path / "a.toml"
    scenario.write_text(
        'title = "t"\nduration_s = 1\n[[expect]]\nflag = "comm"\nis = "bad"\nnever = true\n'
    )
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "flags.csv").write_text("of an earlier run")
    monkeypatch.setattr(f"gateway.reports.{where}", interrupted)
    for words in (["replay", log], ["hil", str(scenario)]):
        assert main([*words, "--results", str(folder)]) == 130
        assert [path.name for path in folder.rglob("*")] == ["flags.csv"]
        assert (folder / "flags.csv").read_text() == "of an earlier run"


def test_files_of_a_folder_appear_together(tmp_path):
    with whole_folder(tmp_path / "out") as part:
        (part / "in").mkdir()
        (part / "in" / "a.csv").write_text("1")
        (part / "b.csv").write_text("2")
        assert not (tmp_path / "out" / "b.csv").exists()
    found = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*")}
    assert found == {"in", "in/a.csv", "b.csv"}


@pytest.mark.parametrize("older", [False, True])
def test_a_folder_made_for_nothing_is_not_left(tmp_path, older):
    folder = tmp_path / "out"
    if older:
        folder.mkdir()

    def interrupted():
        with whole_folder(folder) as part:
            (part / "b.csv").write_text("2")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert folder.exists() == older
    assert not list(tmp_path.rglob("b.csv"))


def test_a_replay_names_the_clock_of_its_times(tmp_path, log, capsys):
    assert main(["replay", log, "--results", str(tmp_path / "r")]) == 0
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("times: ")]
    first = (tmp_path / "a.log").read_text().partition(")")[0].strip("(")
    assert line == f"times: from the first frame, {float(first):.9f} s on the log's clock"
    report = (tmp_path / "r" / "report.md").read_text()
    assert "in `flags.csv` and `estimates.csv` on the log's own clock" in report
