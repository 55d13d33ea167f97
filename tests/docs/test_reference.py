"""The pages of docs/reference in the repository are those that the code gives."""

import importlib.util

import pytest

from tests.docs.pages import ROOT


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs/hooks/reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_committed_pages_are_up_to_date(reference, monkeypatch):
    monkeypatch.setenv("COLUMNS", "96")
    folder = ROOT / "docs" / "reference"
    assert {path.stem for path in folder.iterdir()} == set(reference.COMMITTED)
    made = reference.pages()
    old = [
        name
        for name in reference.COMMITTED
        if (folder / f"{name}.md").read_text(encoding="utf-8") != made[name]
    ]
    assert not old, "write them again: python docs/hooks/reference.py"


def test_a_key_has_its_bounds_with_their_unit(reference):
    page = reference.scenario_page()
    assert "| `depth` | `float 0 to 1` |" in page
    assert "| `drives` | `int >= 1, <= 16` |" in page
    assert "| `after_s` | `float 0 to 10000000 s` |" in page
