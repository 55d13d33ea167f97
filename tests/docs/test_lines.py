"""Links to lines of the code lead to what they name; code that a page shows is what runs."""

from tests.docs.lines import ROOT, definition, links


def test_every_link_to_a_line_leads_to_the_definition():
    found = list(links())
    wrong = [f"{link.page.name}: {link.path}: {link.name}" for link in found
             if link.line != link.defined or not link.defined]  # fmt: skip
    assert len(found) > 30
    assert not wrong, f"python -m tests.docs.lines sets them anew: {wrong}"


def test_a_call_and_a_declaration_are_no_definitions():
    assert definition(ROOT / "gateway/core/busload.h", "bus_load_tick") == 0
    assert definition(ROOT / "gateway/core/tick.c", "bus_load_tick") == 0
    assert definition(ROOT / "gateway/core/gateway.py", "nothing") == 0


def test_the_tick_on_the_page_is_the_tick_that_runs():
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    shown = page.partition("```c\n")[2].partition("```")[0]
    assert shown
    assert shown in (ROOT / "gateway/core/tick.c").read_text(encoding="utf-8")


def test_every_file_in_a_table_of_the_architecture_exists():
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rows = page.partition("| station |")[2].partition("\n\n")[0].splitlines()[2:]
    assert len(rows) > 15
    named = set()
    for row in rows:
        _, files, oracles, tests = (_names(cell) for cell in row.strip("|").split("|"))
        folder = files[0].rpartition("/")[0]
        named |= {name if "/" in name else f"{folder}/{name}" for name in files}
        named |= {f"tests/reference/{name}" for name in oracles}
        named |= {f"tests/unit/{name}" for name in tests}
    assert not [name for name in sorted(named) if not list(ROOT.glob(name))]


def _names(cell):
    return [name for name in cell.split("`")[1::2] if "." in name]
