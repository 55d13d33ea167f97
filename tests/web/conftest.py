"""A real browser, and the monitor as its own process on a recorded log."""

import re
import shutil
import subprocess
import sys
from contextlib import ExitStack, contextmanager

import pytest
from playwright.sync_api import expect, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")
DESK, PHONE = (1366, 900), (390, 844)
PATIENCE_MS = 60_000
"""For whatever comes by itself; the browser's own limits are those of an idle machine."""


@pytest.fixture(scope="module")
def browser(request):
    """Debian's chromium, headless. Playwright's own is not downloaded: benches are offline.

    Of a module: while it is there, no other test in this process can run an event loop.
    """
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        reason = "no chromium here (apt-get install chromium)"
        if request.config.getoption("--require-chromium"):
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        # Its sandbox needs a user who is not root, or rights that containers do not have.
        made = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox"], timeout=2 * PATIENCE_MS
        )
        expect.set_options(timeout=PATIENCE_MS)
        yield made
        made.close()


@contextmanager
def monitor(*words):
    """The address of a monitor that runs with these words."""
    command = [sys.executable, "-m", "gateway", "monitor", *map(str, words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            told = []
            for line in process.stderr:
                told.append(line)
                if found := re.match(r"web: (http://\S+)", line):
                    yield found[1]
                    break
            else:
                pytest.fail("".join(told))
        finally:
            process.terminate()
            process.communicate(timeout=60)


@pytest.fixture(scope="session")
def address(log):
    """Where the page of the log is."""
    with monitor(log, "--web", "127.0.0.1:0") as where:
        yield where


@pytest.fixture
def opened(browser, request):
    """Opens pages; at the end none of them may have had anything to complain of."""
    complaints = []
    expected = []
    with ExitStack() as stack:

        def open_page(where, size=DESK, scheme="light", may_complain="", ready=".drive .flag"):
            if may_complain:
                expected.append(may_complain)
            context = browser.new_context(
                viewport={"width": size[0], "height": size[1]}, color_scheme=scheme
            )
            stack.callback(context.close)
            context.set_default_timeout(PATIENCE_MS)
            page = context.new_page()
            page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
            page.on(
                "console",
                lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None,
            )
            page.on("requestfailed", lambda r: complaints.append(f"failed: {r.url} {r.failure}"))
            page.on(
                "request",
                lambda r: None if r.url.startswith(where.split("?", maxsplit=1)[0].rstrip("/"))
                else complaints.append(f"asked elsewhere: {r.url}"),
            )  # fmt: skip
            page.goto(where)
            if ready:
                page.wait_for_selector(ready)
            return page

        yield open_page
    left = [c for c in complaints if not any(re.search(e, c) for e in expected)]
    assert not left
