"""What the pages show for a CAN interface, as it stands there, on a real one."""

import subprocess

import pytest

from tests.docs.pages import blocks, folder_for, pages
from tests.docs.test_commands import run_page
from tests.hil.chain import ATTEMPTS, Recording, favoured, setting, stalled
from tests.hil.inside import STALLS

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

PAGES = sorted({b.page for page in pages() for b in blocks(page) if b.run == "vcan"})
LATER = "docs/tutorials/"
"""Their commands on a bus are the README's and those of test_vcan_scenarios.py, in another order:
`make test-all` has them."""

TOO_SLOW = "this machine could not keep up"


@pytest.fixture
def no_bus(vcan):
    """The pages make `vcan0` themselves."""
    vcan.link("delete")
    try:
        yield vcan
    finally:
        vcan.link("create")


@pytest.mark.parametrize("page", [
    pytest.param(page, marks=[pytest.mark.thorough] * page.startswith(LATER)) for page in PAGES
])  # fmt: skip
def test_what_a_page_shows_works_on_a_bus(no_bus, page, tmp_path):
    """A page shows the shipped rates, which a kernel in user mode carries only just.

    On a machine that stalls every time the commands run to their end, with a verdict.
    """
    used = setting(no_bus, tmp_path, drives=3)
    verdict = ""
    for k in range(ATTEMPTS):
        recording = Recording(no_bus, tmp_path / f"record{k}", "any")
        folder = tmp_path / f"page{k}"
        folder.mkdir()
        try:
            ran = run_page(page, "vcan", folder_for(folder), favoured(no_bus, 20))
        except AssertionError as failure:
            verdict = str(failure)
            why = TOO_SLOW if TOO_SLOW in verdict else stalled(recording.end(), used)
            assert why, verdict
            print(f"does not count ({why}): {verdict}")
        else:
            assert ran
            return
        finally:
            subprocess.run(["ip", "link", "delete", no_bus.name], check=False, capture_output=True)
    assert TOO_SLOW in verdict or "\nFAIL " in verdict
    pytest.skip(STALLS)
