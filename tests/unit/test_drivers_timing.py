"""Latency by stage, and what is left of it on the disk."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from dbc.frame import MS
from gateway.io.realtime import Histogram
from gateway.io.timing import STAGES, Timing
from gateway.reports.timing import leave


def largest(timing: Timing) -> dict[str, int]:
    return {name: h.largest for name, h in timing.stages.items()}


def test_the_stages_of_a_tick_add_up() -> None:
    timing = Timing(Histogram())
    timing.add(1 * MS, woken=4 * MS, read=5 * MS, stepped=9 * MS, sent=11 * MS)
    assert largest(timing) == dict(
        zip(STAGES, (3 * MS, 1 * MS, 4 * MS, 2 * MS, 10 * MS), strict=True)
    )
    assert timing.latency.total == 1


def test_a_frame_may_come_while_the_tick_begins() -> None:
    timing = Timing(Histogram())
    timing.add(5 * MS, woken=4 * MS, read=6 * MS, stepped=7 * MS, sent=8 * MS)
    assert largest(timing) == dict(zip(STAGES, (0, 1 * MS, 1 * MS, 1 * MS, 3 * MS), strict=True))


def test_a_tick_that_decides_nothing_new_is_not_counted() -> None:
    timing = Timing(Histogram())
    timing.add(None, 1, 2, 3, 4)
    assert timing.latency.total == 0
    timing.add(1, 2, 3, 4, 5)
    timing.add(1, 12, 13, 14, 15)
    assert timing.latency.total == 1
    timing.add(11, 12, 13, 14, 15)
    assert timing.latency.total == 2


def test_octaves_hold_every_value_once() -> None:
    histogram = Histogram()
    values = np.random.default_rng(3).integers(0, 5000, 400).tolist()
    for value in values:
        histogram.add(value)
    octaves = histogram.octaves()
    assert [a for a, _, _ in octaves[1:]] == [b for _, b, _ in octaves[:-1]]
    for begin, below, count in octaves:
        assert count == sum(begin <= value < below for value in values)
    assert sum(count for _, _, count in octaves) == 400
    assert Histogram().octaves() == []


@pytest.mark.parametrize("decided", [[], [0, 2 * MS]])
def test_the_report_says_what_the_histograms_hold(tmp_path, decided) -> None:
    timing = Timing(Histogram())
    for k, stamp in enumerate(decided):
        timing.lateness.add(100_000)
        begin = stamp + (k + 1) * MS
        timing.add(stamp, begin, begin + 10_000, begin + 400_000, begin + 500_000)
    leave(tmp_path, timing.stage_rows(), "Timing of a test", 10 * MS, 2, 0)
    with (tmp_path / "timing.csv").open() as file:
        rows = list(csv.DictReader(file))
    counted = dict.fromkeys(("lateness", *STAGES), 0)
    for row in rows:
        counted[row["stage"]] += int(row["count"])
        assert float(row["from_us"]) < float(row["below_us"])
    assert set(counted.values()) == {len(decided)}
    text = (tmp_path / "report.md").read_text()
    assert "2 ticks of 10 ms, 0 missed" in text
    if decided:
        assert "| frame to flag | 2 | 1.573 | 2.500 | 2.500 | 2.500 | 25.0 % |" in text
    assert "data:image/svg+xml" in (tmp_path / "report.html").read_text()
