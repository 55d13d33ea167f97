"""The scenario files of the virtual clock, unchanged, on a real bus: `hil` in real time."""

import subprocess
from xml.etree import ElementTree as ET

import pytest

from gateway.commands.common import FAILED, INCONCLUSIVE
from gateway.hil.buses import ON_THE_WIRE
from sim.scenario import builtin, builtin_names
from tests.hil.chain import ATTEMPTS, Recording, excused, memory_folder, program, setting
from tests.hil.inside import STALLS

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

REPORTED = "demo"
NAMES = tuple(
    name for name in builtin_names() if not name.startswith("calibration_") and name != REPORTED
)
"""All others that ship but the fault-free runs to calibrate from, which expect nothing."""
QUICK = ("lossy_bus",)
"""For every change; `make test-all` has the others. Off the bus all are: `test_scenarios.py`."""


@pytest.fixture
def folder():
    with memory_folder() as path:
        yield path


def hold(vcan, folder, name, *more, check=lambda done: None):
    """Run a scenario until it holds. more: words; check: of each run, however it ended."""
    scenario = builtin(name)
    injected = any(event.kind in ON_THE_WIRE for event in scenario.event)
    # A kernel in user mode carries the shipped rate of three drives only just.
    used = setting(vcan, folder, scenario.drives, slower=vcan.own_kernel)
    report = folder / "report.xml"
    command = program(vcan, "hil", name, *used.bus, "--config", str(used.config),
                      "--junit", str(report), *more)  # fmt: skip
    for k in range(ATTEMPTS):
        recording = Recording(vcan, folder / f"run{k}")
        done = subprocess.run(command, check=False, capture_output=True)
        log = recording.end()
        check(done)
        if done.returncode == INCONCLUSIVE:
            print(done.stdout.decode())
            continue
        with excused(log, used, injected=injected):
            assert done.returncode == 0, done.stdout.decode() + done.stderr.decode()
            break
    else:
        pytest.skip(STALLS)
    suite = ET.parse(report).getroot()[0]
    assert suite.get("name") == scenario.title
    cases = suite.findall("testcase")
    assert int(suite.get("tests", 0)) == len(cases) >= len(scenario.expect)
    assert suite.get("failures") == "0"


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.thorough] * (n not in QUICK)) for n in NAMES]
)
def test_the_same_scenarios_hold_on_a_real_bus(vcan, folder, name):
    hold(vcan, folder, name)


def test_the_demo_holds_and_its_report_of_a_real_bus_has_timing_and_truth(vcan, folder):
    """A machine that stalls has a report, too."""
    results = folder / "results"

    def check(done):
        said = done.stdout.decode()
        assert done.returncode in (0, FAILED, INCONCLUSIVE), said + done.stderr.decode()
        assert f"report: {results / 'report.html'}" in said
        text = (results / "report.md").read_text()
        starts = ("| ok |", "| **FAILED** |")
        verdicts = [line for line in text.splitlines() if line.startswith(starts)]
        printed = [line for line in said.splitlines() if line.startswith("     ")]
        reasons = [line for line in printed if line.startswith("     inconclusive, ")]
        assert len(reasons) == (done.returncode == INCONCLUSIVE)
        assert len(verdicts) == len(printed) - len(reasons)
        assert ("**FAILED:" in text) == (done.returncode == FAILED)
        assert ("**Inconclusive:" in text) == (done.returncode == INCONCLUSIVE)
        # The drives' process has left what was true, on a clock that begins as the report's does.
        loss = "| 2 | adhesion | loss |"
        begin = next(line for line in text.splitlines() if line.startswith(loss))
        assert abs(float(begin.split("|")[4]) - 3.0) < 0.1
        assert "| frame to flag |" in text
        for name in ("timing.csv", "truth.csv", "flags.csv", "drive3.svg"):
            assert (results / REPORTED / name).stat().st_size > 100

    hold(vcan, folder, REPORTED, "--results", str(results), check=check)
