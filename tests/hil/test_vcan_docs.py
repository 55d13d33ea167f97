"""What the pages show for a CAN interface, as it stands there, on a real one."""

import subprocess

import pytest

from tests.docs.pages import blocks, folder_for, pages
from tests.docs.test_commands import run_page

PAGES = sorted({b.page for page in pages() for b in blocks(page) if b.run == "vcan"})


@pytest.mark.vcan
@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_shows_works_on_a_bus(page, tmp_path):
    gone = ["ip", "link", "delete", "vcan0"]
    subprocess.run(gone, check=False, capture_output=True)
    try:
        assert run_page(page, "vcan", folder_for(tmp_path))
    finally:
        subprocess.run(gone, check=False, capture_output=True)
