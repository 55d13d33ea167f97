"""A file or folder that a page names exists, so that a move cannot leave a page behind."""

import re

import pytest

from tests.docs.pages import ROOT, pages

TOPS = ("dbc", "estimators", "gateway", "sim", "tests", "bench", "docs", "examples")
PATH = re.compile(rf"`((?:{'|'.join(TOPS)})/[\w./-]*)`")
LINK = re.compile(r"\]\(([\w./-]+)(?:#[\w-]*)?\)")
GENERATED = ("reference/commands.md",)
"""Pages that only the build of the site makes; `--help` has the same text."""


@pytest.mark.parametrize("page", pages())
def test_every_path_exists(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    gone = [path for path in PATH.findall(text) if not (ROOT / path).exists()]
    here = (ROOT / page).parent
    gone += [
        link for link in LINK.findall(text)
        if not link.removeprefix("../").startswith(GENERATED) and not (here / link).exists()
    ]  # fmt: skip
    assert not gone


def test_paths_and_links_are_found():
    assert "docs/architecture.md" in LINK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(LINK.findall((ROOT / "docs/index.md").read_text(encoding="utf-8"))) > 30
    assert len(PATH.findall((ROOT / "docs/extending.md").read_text(encoding="utf-8"))) > 50
