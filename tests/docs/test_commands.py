"""Every command that a page shows is run, in the order of the page, in a folder of its own."""

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gateway import cli
from tests.docs.pages import ROOT, blocks, folder_for, pages

ALL = [block for page in pages() for block in blocks(page)]
REASONS = ("no, ", "vcan")


def run_page(page, where, folder, first=()):
    """Run the page's blocks of that kind; files are written as they come. Gives what was run.

    first: what the shell is started by.
    """
    env = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    ran = []
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "sh" and block.run == where:
            done = subprocess.run(
                [*first, "bash", "-euc", block.text], cwd=folder, env=env, capture_output=True,
                text=True, check=False, timeout=1700,
            )  # fmt: skip
            said = f"{page}:{block.line}\n{block.text}\n{done.stdout}\n{done.stderr}"
            assert done.returncode == 0, said
            ran.append(block.text)
    return ran


INLINE = re.compile(r"`traction-gateway ([a-z-]+)([^`]*)`")


@pytest.mark.parametrize("page", pages())
def test_what_a_sentence_names_exists(page):
    """Verbs and options within lines are not run, but they are real."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for verb, rest in INLINE.findall(text):
        assert verb in cli.VERBS, f"{page}: {verb}"
        options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest))
        helped = io.StringIO()
        with contextlib.redirect_stdout(helped), pytest.raises(SystemExit):
            cli.main([verb, "--help"])
        known = set(re.findall(r"--[a-z][a-z-]*", helped.getvalue()))
        assert options <= known, f"{page}: {verb} {options - known}"


FIRST = ("README.md", "docs/inverters.md", "docs/tutorials/")
"""Pages that a new user follows: for every change. `make test-all` has the others."""
LATER = tuple(f"docs/tutorials/{name}.md" for name in ("hil_tests", "shrink", "slip_bench"))
"""What they show is run by test_testing.py and test_hil_mutate.py, test_shrink.py, and
test_hil_slip.py."""


def is_for_later(page):
    return page in LATER or not page.startswith(FIRST)


@pytest.mark.parametrize("page", [
    pytest.param(page, marks=[pytest.mark.thorough] * is_for_later(page))
    for page in sorted({b.page for b in ALL if b.language == "sh" and b.run == "here"})
])  # fmt: skip
@pytest.mark.slow
def test_what_a_page_shows_works(page, tmp_path):
    assert run_page(page, "here", folder_for(tmp_path))


def test_what_is_for_a_terminal_says_so_and_what_is_not_run_says_why():
    for block in ALL:
        where = f"{block.page}:{block.line}"
        if block.commands:
            assert block.language == "sh", f"{where}: commands, so ```sh"
        if block.run != "here":
            assert block.language == "sh", where
            assert block.run.startswith(REASONS), where
            assert block.run == "vcan" or len(block.run) > len("no, ") + 10, where
    assert sum(block.language == "sh" for block in ALL) > 15
    assert len(INLINE.findall("".join((ROOT / page).read_text() for page in pages()))) > 15
