"""The scenario files of the virtual clock, unchanged, on a real bus: `hil` in real time."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

from sim.scenario import builtin, builtin_names
from tests.hil.chain import ATTEMPTS, Recording, excused, memory_folder, program, setting

if TYPE_CHECKING:
    from conftest import Vcan

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

NAMES = tuple(name for name in builtin_names() if not name.startswith("calibration_"))
"""All that ship but the fault-free runs to calibrate from, which expect nothing."""
ON_THE_WIRE = {"silent", "frame_loss", "corrupt"}
"""Events that look like a machine that stalls."""


@pytest.fixture
def folder() -> Iterator[Path]:
    with memory_folder() as path:
        yield path


@pytest.mark.parametrize("name", NAMES)
def test_the_same_scenarios_hold_on_a_real_bus(vcan: Vcan, folder: Path, name: str) -> None:
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
