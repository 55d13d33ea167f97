"""Rows of results name the code that made them; a skipped test on a real bus has failed."""

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from tests import provenance
from tests.hil.inside import STALLS
from tests.provenance import RESULTS, code_of, commit_of

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("results", RESULTS)
def test_results_that_have_grown_are_no_change_of_the_code(tmp_path, results):
    def git(*words):
        who = "-c", "user.name=a", "-c", "user.email=a@localhost"
        words = ["git", "-C", str(tmp_path), *who, *words]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()

    code, grown = tmp_path / "core.py", tmp_path / results
    grown.parent.mkdir(parents=True)
    assert commit_of(tmp_path) == "unknown"
    git("init", "-q")
    for path in (code, grown):
        path.write_text("1\n")
    git("add", "-A")
    git("commit", "-qm", "first")
    commit = git("rev-parse", "--short", "HEAD")
    grown.write_text("1\n2\n")
    (tmp_path / "new").write_text("not known to git")
    assert commit_of(grown.parent) == commit
    code.write_text("2\n")
    assert commit_of(grown.parent) == f"{commit}-dirty"


def test_results_are_kept_where_they_are_looked_for():
    for name in RESULTS:
        assert (ROOT / name).is_file()


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    """Of a folder: a module of its own, and one of its environment."""
    for path in ("own_code.py", ".venv/lib/library_code.py"):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("value = 1\n")
        monkeypatch.syspath_prepend(str(file.parent))
        importlib.import_module(file.stem)
    yield tmp_path
    for name in ("own_code", "library_code"):
        sys.modules.pop(name, None)


def test_code_is_told_by_what_is_loaded_of_a_folder(loaded):
    before = code_of(loaded)
    (loaded / "not_loaded.py").write_text("value = 1\n")
    (loaded / ".venv/lib/library_code.py").write_text("value = 2\n")
    assert code_of(loaded) == before
    (loaded / "own_code.py").write_text("value = 2\n")
    assert code_of(loaded) != before


def test_the_same_code_elsewhere_has_the_same_name(loaded, tmp_path_factory, monkeypatch):
    before = code_of(loaded)
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "own_code.py").write_text("value = 1\n")
    monkeypatch.setattr(sys.modules["own_code"], "__file__", str(elsewhere / "own_code.py"))
    assert code_of(elsewhere) == before


def test_what_was_started_is_not_in_the_name_of_the_code(loaded, monkeypatch):
    monkeypatch.setitem(sys.modules, "__main__", sys.modules.pop("own_code"))
    monkeypatch.setitem(sys.modules, "__mp_main__", sys.modules["__main__"])
    before = code_of(loaded)
    (loaded / "own_code.py").write_text("value = 2\n")
    assert code_of(loaded) == before


def test_what_names_the_code_is_not_in_its_name(monkeypatch):
    before = code_of(ROOT)
    monkeypatch.delitem(sys.modules, provenance.__name__)
    assert code_of(ROOT) == before


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


def test_only_the_clock_of_the_machine_may_be_left_alone(hil):
    reports = [report("skipped", hil.OWN_CLOCK), report("skipped", STALLS)]
    hil.oblige(reports)
    assert [each.outcome for each in reports] == ["skipped", "failed"]
