"""The pages of docs/reference in the repository are those that the code gives."""

import hashlib
import importlib.util

import pytest

import gateway
from tests.docs.pages import ROOT

SIGNATURES = ROOT / "tests" / "docs" / "signatures.txt"


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


def test_every_public_name_is_in_the_reference(reference):
    assert set(reference.PUBLIC) == set(reference.gateway_api.__all__)
    assert set(gateway.__all__) < set(reference.PUBLIC)


def test_a_changed_signature_of_the_api_needs_a_changelog_entry(reference):
    """An entry vouches for the signatures by their digest: a change needs another, or an edit."""
    made = reference.signatures()
    old = SIGNATURES.read_text(encoding="utf-8")
    assert made == old, f"tell users in changelog.d, then write the new ones into {SIGNATURES}"
    digest = hashlib.sha256(made.encode()).hexdigest()[:8]
    entries = [ROOT / "CHANGELOG.md", *(ROOT / "changelog.d").glob("[0-9+]*.md")]
    written = [path for path in entries if f"<!-- API {digest} -->" in path.read_text("utf-8")]
    assert written, f"the entry about the change ends with <!-- API {digest} -->"


@pytest.mark.parametrize("page", ["configuration", "scenario_page", "messages"])
def test_every_key_and_signal_has_a_meaning(reference, page):
    made = reference.messages("traction.dbc") if page == "messages" else getattr(reference, page)()
    rows = [line.split(" | ") for line in made.splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert not [row[0] for row in rows if not row[-1].strip(" |")]


def test_a_meaning_of_a_key_that_does_not_exist_is_refused(reference, monkeypatch):
    monkeypatch.setitem(reference.comments()["loop"], "rate", "of the loop")
    with pytest.raises(LookupError, match=r"\[loop\] has no rate"):
        reference.configuration()
