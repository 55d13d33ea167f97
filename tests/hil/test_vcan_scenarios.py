"""The scenario files of the virtual clock, unchanged, on a real bus: `hil` in real time."""

import subprocess
from xml.etree import ElementTree as ET

import pytest

from gateway.commands.common import FAILED, INCONCLUSIVE
from gateway.hil.buses import ON_THE_WIRE
from sim.scenario import builtin, builtin_names
from tests.hil.chain import ATTEMPTS, Recording, excused, memory_folder, program, setting

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

NAMES = tuple(name for name in builtin_names() if not name.startswith("calibration_"))
"""All that ship but the fault-free runs to calibrate from, which expect nothing."""
QUICK = ("demo", "lossy_bus", "silent")
"""For every change; `make test-all` has the others. Off the bus all are: `test_scenarios.py`."""


@pytest.fixture
def folder():
    with memory_folder() as path:
        yield path


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.thorough] * (n not in QUICK)) for n in NAMES]
)
def test_the_same_scenarios_hold_on_a_real_bus(vcan, folder, name):
    scenario = builtin(name)
    injected = any(event.kind in ON_THE_WIRE for event in scenario.event)
    # A kernel in user mode carries the shipped rate of three drives only just.
    used = setting(vcan, folder, scenario.drives, slower=vcan.own_kernel)
    report = folder / "report.xml"
    command = program(vcan, "hil", name, *used.bus, "--config", str(used.config),
                      "--junit", str(report))  # fmt: skip
    for k in range(ATTEMPTS):
        recording = Recording(vcan, folder / f"run{k}")
        done = subprocess.run(command, check=False, capture_output=True)
        log = recording.end()
        if done.returncode == INCONCLUSIVE:
            print(done.stdout.decode())
            continue
        with excused(log, used, injected=injected):
            assert done.returncode == 0, done.stdout.decode() + done.stderr.decode()
            break
    else:
        raise AssertionError("this machine stalls")
    suite = ET.parse(report).getroot()[0]
    assert suite.get("name") == scenario.title
    cases = suite.findall("testcase")
    assert int(suite.get("tests", 0)) == len(cases) >= len(scenario.expect)
    assert suite.get("failures") == "0"


def test_the_report_of_a_real_bus_has_timing_and_truth(vcan, folder):
    """Verdicts are not asked for here: a machine that stalls has a report too."""
    used = setting(vcan, folder, builtin("release").drives, slower=vcan.own_kernel)
    results = folder / "results"
    command = program(vcan, "hil", "release", *used.bus, "--config", str(used.config),
                      "--results", str(results))  # fmt: skip
    done = subprocess.run(command, check=False, capture_output=True)
    said = done.stdout.decode()
    assert done.returncode in (0, FAILED, INCONCLUSIVE), said + done.stderr.decode()
    assert f"report: {results / 'report.html'}" in said
    text = (results / "report.md").read_text()
    verdicts = [line for line in text.splitlines() if line.startswith(("| ok |", "| **FAILED** |"))]
    assert len(verdicts) == sum(line.startswith("     ") for line in said.splitlines())
    assert ("**FAILED:" in text) == (done.returncode == FAILED)
    assert ("**Inconclusive:" in text) == (done.returncode == INCONCLUSIVE)
    # The drives' process has left what was true, on a clock that begins as the report's does.
    assert "| 1 | adhesion | loss |" in text
    begin = next(line for line in text.splitlines() if line.startswith("| 1 | adhesion | loss |"))
    assert abs(float(begin.split("|")[4]) - 2.0) < 0.1
    assert "| frame to flag |" in text
    for name in ("timing.csv", "truth.csv", "flags.csv", "drive3.svg"):
        assert (results / "release" / name).stat().st_size > 100
