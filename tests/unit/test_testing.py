"""The pytest plugin as its user meets it, and the picture of a failure."""

import re
from pathlib import Path

import pytest

from dbc.frame import MS
from gateway.core.codes import Flag
from gateway.hil.pytest import picture
from tests.programs import ended, gateway

EXAMPLE = Path(__file__).parents[2] / "examples" / "regression"

SUITE = """
import pytest

def test_too_fast(inverter, gateway_flags):
    inverter.lose_adhesion(drive=2, depth=0.15)
    gateway_flags.expect_lost(drive=2, within_ms=10)

def test_never(inverter, gateway_flags):
    inverter.silence(drive=1)
    gateway_flags.expect_never("adhesion", "unknown", drive=1, for_ms=800)

@pytest.mark.hil(settle=False)
def test_unknown_at_first(hil_bench, gateway_flags):
    hil_bench.run(0.05)
    assert gateway_flags.now("adhesion", 3).name == "UNKNOWN"
    assert hil_bench.now_s == pytest.approx(0.05)

@pytest.mark.hil(drives=2, speeed=3)
def test_misspelt(hil_bench):
    pass

@pytest.mark.hil(config="none.toml")
def test_no_such_config(hil_bench):
    pass

@pytest.mark.hil("release")
def test_unnamed(hil_bench):
    pass

def test_no_drive_to_lose(inverter):
    inverter.lose_adhesion(drive=7)

def test_no_such_drive(gateway_flags):
    gateway_flags.expect_lost(drive=9, within_ms=10)

def test_no_such_fault(inverter):
    with pytest.raises(ValueError, match="drive: 7"):
        inverter.lose_adhesion(drive=7)

@pytest.mark.parametrize(("call", "said"), [
    (lambda _, i: i.lose_adhesion(1, depth=90), "^depth: expected 0 to 1, got 90.0: a fraction"),
    (lambda _, i: i.lose_adhesion(1, depth=0), "^depth: 0 has no effect"),
    (lambda f, _: f.now("adhesio", 1), "^no flag 'adhesio': expected one of adhesion, thermal, "),
    (lambda f, _: f.expect("adhesion", "lost", drive=1, within_ms=9), "^no state 'lost' of a flag"),
    (lambda f, _: f.expect_lost(drive=1, within_ms=-9), "^expected a time of more than 0 ms"),
    (lambda f, _: f.expect_never_lost(drive=1, for_ms=0), "^expected a time of more than 0 ms"),
    (lambda f, _: f.expect_lost(drive=1, within_ms=float("nan")), "more than 0 ms, got nan"),
])
def test_mistakes_are_plain(call, said, gateway_flags, inverter):
    with pytest.raises(ValueError, match=said):
        call(gateway_flags, inverter)
"""


def run_pytest(folder, *words, python=()):
    return ended(*python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words, folder=folder)


@pytest.fixture(scope="module")
def failures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    (folder / "test_suite.py").write_text(SUITE)
    scenario = (EXAMPLE / "hil_wet_rail.toml").read_text()
    hasty = scenario.replace("within_ms = 100", "within_ms = 10")
    hasty = hasty.replace('kind = "rail"\nvalue = "leaves"', 'kind = "adhesion_loss"\ndepth = 0.15')
    (folder / "hil_hasty.toml").write_text(hasty)
    (folder / "hil_empty.toml").write_text('title = "nothing"\nduration_s = 1\n')
    for name in ("other", "test_data", "a_test", "hill"):
        (folder / f"{name}.toml").write_text("not = 'a scenario'")
    done = run_pytest(folder, "--continue-on-collection-errors", "-rA")
    assert done.returncode == 1, done.stdout + done.stderr
    return done.stdout


def test_a_failure_says_what_was_seen(failures):
    assert "adhesion of drive 2 was expected to be bad within 10 ms; it is good" in failures
    assert "was expected never to be unknown for 800 ms; it was after" in failures
    lines = failures[failures.index("_ test_too_fast _") :].splitlines()
    truth = next(line for line in lines if "drive 2 truly" in line)
    flag = next(line for line in lines if "drive 2 adhesion" in line)
    assert truth.rstrip().endswith("#")
    assert flag.rstrip().endswith("-")
    assert "Gateway_Adhesion  Reason=0 Adhesion1=good" in failures
    # Silence looks like what it is: the flag of drive 1 goes from good to unknown.
    assert "Gateway_Adhesion  Reason=2 Adhesion2=good" in failures


def test_a_scenario_that_fails_says_so(failures):
    assert "adhesion of drive 3 bad after 3 s within 10 ms: after" in failures
    assert "FAILED hil_hasty.toml::0-adhesion-3-bad" in failures
    assert "PASSED hil_hasty.toml::1-adhesion-others-never-bad" in failures
    assert "no [[expect]]: nothing would be tested" in failures
    for name in ("other", "test_data", "a_test", "hill"):
        assert f"{name}.toml" not in failures


def test_mistakes_of_a_test_are_named(failures):
    assert failures.count("PASSED test_suite.py::test_mistakes_are_plain") == 7
    assert "speeed" in failures
    assert "drive 9 is not one of (1, 2, 3)" in failures
    assert "PASSED test_suite.py::test_no_such_fault" in failures
    assert "none.toml: no such file" in failures
    assert "hil marker: name what 'release' is: hil(scenario=NAME or FILE, " in failures
    assert "drive: 7 is not one of the nodes 1, 2, 3" in failures
    for ours in ("plugin.py", "inverter.py", "faults.py", "fitting.py", "config.py"):
        assert ours not in failures, "no traceback through this package"
    assert "PASSED test_suite.py::test_unknown_at_first" in failures


def test_toml_of_another_project_is_none_of_ours_unless_it_says_so(tmp_path):
    """The plugin is loaded wherever this package is installed."""
    (tmp_path / "test_data.toml").write_text("[table]\nof = 'somebody else'\n")
    (tmp_path / "test_one.py").write_text("def test_one():\n    pass\n")
    done = run_pytest(tmp_path)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout
    done = run_pytest(tmp_path, "-o", "hil_scenarios=test_*.toml")
    assert done.returncode == 2
    assert "test_data.toml" in done.stdout


KNOWING = """
import pytest

def test_all_the_time(hil_bench):
    hil_bench.run(1.0)

def test_half_of_it(hil_bench, inverter):
    hil_bench.run(1.0)
    inverter.silence(drive=1)
    hil_bench.run(1.0)

@pytest.mark.hil(expect_known=30)
def test_so_much_is_enough_here(hil_bench, inverter):
    test_half_of_it(hil_bench, inverter)
"""


def test_flags_that_know_for_less_than_is_expected_are_a_failure(tmp_path):
    (tmp_path / "test_known.py").write_text(KNOWING)
    scenario = "hil_wet_rail.toml"
    (tmp_path / scenario).write_text((EXAMPLE / scenario).read_text())
    done = run_pytest(tmp_path, "-rA", "--hil-expect-known", "90")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "PASSED test_known.py::test_all_the_time" in done.stdout
    assert "FAILED test_known.py::test_half_of_it" in done.stdout
    assert "adhesion of drive 1 was known for 5" in done.stdout
    assert "adhesion of drive 2 was known" not in done.stdout
    assert "PASSED test_known.py::test_so_much_is_enough_here" in done.stdout
    assert f"PASSED {scenario}::0-adhesion-3-bad" in done.stdout
    done = run_pytest(tmp_path, "-rA", "--hil-expect-known", "thermal=99", scenario)
    assert done.returncode == 1
    assert "FAILED" in done.stdout
    assert "PASSED" not in done.stdout
    assert "thermal of drive 1 was known for" in done.stdout
    done = run_pytest(tmp_path, "--hil-expect-known", "most")
    assert done.returncode == 4
    assert "--hil-expect-known: 'most' is not a percentage" in done.stderr


OF_MINE = """
import sim

def test_both_are_there(inverter, gateway_flags):
    import dbc
    import sim as again
    assert (sim.MINE, dbc.MINE) == (1, 2)
    assert again is sim
    inverter.lose_adhesion(drive=2, depth=1.0)
    gateway_flags.expect_lost(drive=2, within_ms=200)

def test_again(inverter, gateway_flags):
    test_both_are_there(inverter, gateway_flags)
"""


@pytest.mark.parametrize(
    ("python", "scenarios", "passed"), [(["-P"], ["hil_wet_rail.toml"], 4), ([], [], 2)],
    ids=["pytest, a scenario first", "python -m pytest, their sim first"],
)  # fmt: skip
def test_files_of_a_user_may_have_the_names_of_our_packages(tmp_path, python, scenarios, passed):
    """`-P`: the folder comes onto the path with its first test in Python, as of `pytest`."""
    (tmp_path / "sim.py").write_text("MINE = 1")
    (tmp_path / "dbc.py").write_text("MINE = 2")
    (tmp_path / "estimators.py").write_text("raise SystemExit('mine')")
    (tmp_path / "test_suite.py").write_text(OF_MINE)
    for name in scenarios:
        (tmp_path / name).write_text((EXAMPLE / name).read_text())
    done = run_pytest(tmp_path, python=python)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{passed} passed" in done.stdout


def test_the_program_as_a_module_passes_by_files_with_the_names_of_our_packages(tmp_path):
    for name in ("dbc", "sim", "estimators"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('mine')")
    done = gateway("check", EXAMPLE.parent / "train.toml", folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_options_that_do_not_go_together_are_refused(tmp_path):
    two_on_a_bus = ["--can-interface", "virtual", "-n", "2"]
    for words in (["--can-channel", "vcan0"], ["--hil-gateway", "external"], two_on_a_bus):
        done = run_pytest(tmp_path, *words)
        assert done.returncode == 4
        assert "--can-interface" in done.stderr


LATE = """
import time

import pytest

@pytest.mark.hil(settle=False)
def test_late(hil_bench, gateway_flags):
    hil_bench.run(0.02)
    time.sleep(0.2)
    gateway_flags.expect("thermal", "bad", drive=1, within_ms=20)
"""


def test_a_failure_on_a_bus_whose_ticks_were_missed_is_called_inconclusive(tmp_path):
    (tmp_path / "test_late.py").write_text(LATE)
    done = run_pytest(tmp_path, "--can-interface", "virtual", "--can-channel", "late")
    assert done.returncode == 1, done.stderr
    found = re.search(r"inconclusive: the test's own process missed (\d+) ticks", done.stdout)
    assert int(found[1]) >= 15
    # On the virtual clock nothing can be missed.
    done = run_pytest(tmp_path)
    assert "thermal of drive 1 was expected to be bad" in done.stdout
    assert "inconclusive" not in done.stdout


TWICE = """
from _pytest.runner import runtestprotocol
from gateway.hil.pytest import scenarios
from gateway.hil.pytest.bench import HilBench

made = []
scenarios.HilBench = lambda *given, **more: made.append(HilBench(*given, **more)) or made[-1]

def pytest_runtest_protocol(item, nextitem):  # as pytest-rerunfailures
    reports = runtestprotocol(item, nextitem=nextitem)
    if any(report.failed for report in reports):
        runtestprotocol(item, nextitem=nextitem)
    return True

def pytest_sessionfinish():
    print("runs:", len(made))
"""


def test_an_expectation_that_is_tested_again_is_tested_on_a_new_run(tmp_path):
    (tmp_path / "conftest.py").write_text(TWICE)
    text = (EXAMPLE / "hil_wet_rail.toml").read_text()
    (tmp_path / "hil_wet_rail.toml").write_text(text)
    assert "runs: 1\n" in run_pytest(tmp_path).stdout
    (tmp_path / "hil_wet_rail.toml").write_text(text.replace("within_ms = 100", "within_ms = 1"))
    done = run_pytest(tmp_path)
    assert "runs: 2\n" in done.stdout
    assert "2 failed, 1 passed" in done.stdout


def test_a_strip_of_time():
    points = [(0, Flag.UNKNOWN), (320 * MS, Flag.GOOD), (480 * MS, Flag.BAD), (490 * MS, Flag.GOOD)]
    text = picture.strip(points, 0, 640 * MS)
    assert text == "?" * 31 + "-" * 16 + "#" + "-" * 16
    assert picture.strip([], 0, 640 * MS) == " " * 64
    assert picture.strip([(320 * MS, Flag.BAD)], 0, 640 * MS).startswith(" " * 31 + "#")
