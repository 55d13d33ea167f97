"""Pictures of a report: whatever the values are, well-formed, inside the panel, the same again."""

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.reports.svg import HEIGHTS, INCH, Bar, Line, Panel, write_panels
from gateway.reports.trace import Curve

NUMBERS = st.lists(st.floats(width=64), min_size=0, max_size=40)


def curve(low, high=None):
    low = np.asarray(low, float)
    return Curve(0.01 * np.arange(len(low)), low, low if high is None else np.asarray(high, float))


def drawn(folder, *panels, end_s=1.0, true=False):
    write_panels(folder / "a.svg", panels, end_s, true=true)
    return ET.fromstring((folder / "a.svg").read_text())


def kinds(root, tag):
    return [e.get("class") for e in root.iter(f"{{http://www.w3.org/2000/svg}}{tag}")]


def paths(root):
    """Points of the paths that are no pattern, dotted line or key."""
    shapes = [e.get("d") for e in root.iter("{http://www.w3.org/2000/svg}path")]
    shapes = [d for d in shapes if "h15" not in d and "H" not in d and "5L5" not in d]
    return [
        [tuple(map(float, p.split())) for p in re.findall(r"[\d.-]+ [\d.-]+", d)] for d in shapes
    ]


@settings(max_examples=60)
@given(NUMBERS, st.booleans(), st.booleans())
def test_any_values_give_a_picture_whose_lines_are_in_their_panel(
    tmp_path_factory, values, bridge, band
):
    line = Line(curve(values), "red", "a", bridge=bridge, band=band)
    folder = tmp_path_factory.mktemp("svg")
    root = drawn(folder, Panel(1.0, "y", named=True, lines=[line]))
    for points in paths(root):
        assert all(0.0 <= y <= 2 * INCH for _, y in points)


def test_a_line_is_interrupted_where_nothing_is_known_unless_bridged(tmp_path):
    values = [1.0, 2.0, np.nan, 2.0, 1.0]
    for bridge, pieces in ((False, 2), (True, 1)):
        drawn(tmp_path, Panel(1.0, lines=[Line(curve(values), "red", "a", bridge=bridge)]))
        assert (
            re.search(r'<path d="(M[^"h]*)" stroke="red"', (tmp_path / "a.svg").read_text())[
                1
            ].count("M")
            == pieces
        )


def test_merged_ticks_and_a_band_are_areas_from_the_smallest_to_the_largest(tmp_path):
    area = curve([0.0, 0.0, 0.0], [1.0, 2.0, 1.0])
    root = drawn(tmp_path, Panel(1.0, lines=[Line(area, "red", "a")]))
    shape, middle = paths(root)
    assert len(shape) == 6
    assert len(middle) == 3
    (shape,) = paths(drawn(tmp_path, Panel(1.0, lines=[Line(area, "red", "a", band=True)])))
    assert len(shape) == 6


def test_bars_are_at_their_times_in_their_rows_each_kind_with_a_height_of_its_own(tmp_path):
    bars = [Bar(k, 0.25, 0.5, kind) for k, kind in enumerate(HEIGHTS)]
    root = drawn(tmp_path, Panel(2.0, rows=list(HEIGHTS), bars=bars), true=True)
    found = list(root.iter("{http://www.w3.org/2000/svg}rect"))[: len(bars)]
    assert [e.get("class") for e in found] == list(HEIGHTS)
    assert len({e.get("x") for e in found}) == len({e.get("width") for e in found}) == 1
    heights = [float(e.get("height")) for e in found]
    assert sorted(heights) == [heights[k] for k in (0, 1, 4 - 1, 2, 4)]
    assert [float(e.get("y")) for e in found] == sorted(float(e.get("y")) for e in found)
    assert "true" in kinds(root, "rect")


def test_a_flat_curve_has_the_least_span_so_that_noise_is_not_an_event(tmp_path):
    noise = curve(25.0 + 0.01 * np.sin(np.arange(50)))
    (points,) = paths(drawn(tmp_path, Panel(1.0, least=2.0, lines=[Line(noise, "red", "a")])))
    heights = [y for _, y in points]
    assert max(heights) - min(heights) < 0.02 * INCH


@pytest.mark.parametrize(
    ("span_s", "last"), [(0.0, "0.0010"), (0.05, "0.05"), (7.0, "7"), (86400.0, "80000")]
)
def test_times_are_round_numbers(tmp_path, span_s, last):
    root = drawn(tmp_path, Panel(1.0, note="nothing"), end_s=span_s)
    texts = [e.text for e in root.iter("{http://www.w3.org/2000/svg}text")]
    assert last in texts
    assert "0" in texts or "0.00" in texts or "0.0000" in texts


def test_a_picture_loads_nothing_and_is_the_same_again(tmp_path):
    panel = Panel(1.0, "y", named=True, lines=[Line(curve([1.0, 2.0]), "red", "a")])
    drawn(tmp_path, panel)
    text = (tmp_path / "a.svg").read_text()
    drawn(tmp_path, panel)
    assert (tmp_path / "a.svg").read_text() == text
    assert re.findall(r"https?://[^\"' ]*", text) == ["http://www.w3.org/2000/svg"]
