"""Every name in the glossary's column "code" is one: in the code, or a path of the repository."""

import re

from tests.docs.pages import ROOT

SOURCES = ("dbc", "estimators", "gateway", "sim")
KINDS = {".py", ".c", ".h"}


def rows():
    """(term, names) of each line of each table."""
    page = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    for line in page.splitlines():
        if line.startswith("| ") and not line.startswith("| term "):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            yield cells[0], cells[1].split("`")[1::2], len(cells)


def test_every_name_is_found_in_the_code():
    files = [p for folder in SOURCES for p in (ROOT / folder).rglob("*") if p.suffix in KINDS]
    code = "\n".join(path.read_text(encoding="utf-8") for path in files)
    gone = [
        f"{term}: {name}"
        for term, names, _ in rows()
        for name in names
        if not (ROOT / name).exists() and not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", code)
    ]
    assert not gone


def test_every_row_has_its_five_cells_and_a_term_stands_once():
    terms = [term for term, _, _ in rows()]
    assert len(terms) > 80
    assert {cells for _, _, cells in rows()} == {5}
    assert not [term for term in terms if terms.count(term) > 1]
