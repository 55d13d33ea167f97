"""Where SocketCAN is required, what is skipped on it has failed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

PATH = Path(__file__).parents[1] / "hil" / "conftest.py"


@pytest.fixture(scope="module")
def hil():
    spec = importlib.util.spec_from_file_location("hil_conftest", PATH)
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, spec.name, module)  # where its classes look for themselves
        spec.loader.exec_module(module)
    return module


def report(outcome, reason, when="setup"):
    where = ("test_x.py", 1, f"Skipped: {reason}") if outcome == "skipped" else None
    return pytest.TestReport("test_x.py::test", ("test_x.py", 1, "test"), {}, outcome, where, when)


def test_a_skipped_test_has_failed(hil):
    reports = [report("skipped", "no slcan here"), report("passed", "", "teardown")]
    hil.oblige(reports)
    assert [each.outcome for each in reports] == ["failed", "passed"]
    assert "no slcan here" in reports[0].longrepr


def test_the_clock_of_the_machine_may_be_left_alone(hil):
    reports = [report("skipped", hil.OWN_CLOCK)]
    hil.oblige(reports)
    assert [each.outcome for each in reports] == ["skipped"]
