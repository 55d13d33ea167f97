"""A run's report in real headless Chromium: pictures zoom, an event leads to its second."""

import pytest
from playwright.sync_api import expect

from gateway.cli import main


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    words = ["sim", "release", "-o", str(folder / "drive.log"), "--truth", str(folder / "t.csv")]
    assert main([*words, "--duration", "6"]) == 0
    words = ["replay", str(folder / "drive.log"), "--truth", str(folder / "t.csv")]
    assert main([*words, "--results", str(folder / "results")]) == 0
    return folder / "results" / "report.html"


def test_an_event_leads_to_its_second_in_the_picture_of_its_drive(report, opened):
    page = opened(f"file://{report}", ready=".zoom")
    row = page.locator("tr", has=page.locator("text=loss")).filter(has_text="adhesion").first
    drive, seconds = row.locator("td").first.inner_text(), row.locator("a").inner_text()
    row.locator("a").click()
    box = page.locator(f".zoom:has(img[alt*='of drive {drive} over time'])")
    mark = box.locator("i")
    expect(mark).to_be_visible()
    # Where its axis of time has that second, and in the middle of what is shown.
    left, right, span = (float(x) for x in box.locator("img").get_attribute("data-x").split())
    picture, window, at = (part.bounding_box() for part in (box.locator("img"), box, mark))
    wanted = picture["x"] + picture["width"] * (left + (right - left) * float(seconds) / span)
    assert at["x"] == pytest.approx(wanted, abs=2.0)
    assert window["x"] <= at["x"] <= window["x"] + window["width"]
    others = page.locator(".zoom i:visible")
    assert others.count() == 1


def test_a_picture_zooms_and_keeps_its_middle(report, opened):
    page = opened(f"file://{report}", ready=".zoom")
    box = page.locator(".zoom").nth(1)
    before = box.locator("img").bounding_box()["width"]
    page.locator(".tools input").nth(1).fill("8")
    assert box.locator("img").bounding_box()["width"] == pytest.approx(8 * before, rel=0.01)
    middle = box.evaluate("b => (b.scrollLeft + b.clientWidth / 2) / b.scrollWidth")
    assert middle == pytest.approx(0.5, abs=0.01)
