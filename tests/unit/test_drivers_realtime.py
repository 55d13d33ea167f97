"""Ticker, histogram and latency by stage, on a clock that only the test moves."""

import csv
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from dbc.frame import MS
from gateway.io.realtime import Histogram, Ticker
from gateway.io.timing import STAGES, Timing
from gateway.reports.timing import Timed, leave
from tests.buses import Clock


def make(period_ns=10 * MS):
    clock = Clock(1_000 * MS)
    return clock, Ticker(period_ns, clock, clock.sleep)


def test_first_tick_is_now_and_sets_the_grid():
    clock, ticker = make()
    assert ticker.wait() == (0, 1_000 * MS, 0)
    assert ticker.wait() == (1, 1_010 * MS, 0)
    assert clock.sleeps == 1


def test_deadlines_are_absolute_so_lateness_does_not_add_up():
    clock, ticker = make()
    clock.late_ns = 2 * MS
    ticks = [ticker.wait() for _ in range(50)]
    assert [t.number for t in ticks] == list(range(50))
    assert ticks[-1].now_ns == 1_000 * MS + 49 * 10 * MS + 2 * MS
    assert ticker.missed == 0


def test_work_within_the_period_does_not_shift_the_grid():
    clock, ticker = make()
    ticker.wait()
    clock.now += 7 * MS
    assert ticker.wait().now_ns == 1_010 * MS


@pytest.mark.parametrize(
    ("stall_ms", "number", "missed"),
    [(9, 1, 0), (19, 1, 0), (20, 2, 1), (29, 2, 1), (5_000, 500, 499)],
)
def test_missed_ticks_are_skipped_and_counted(stall_ms, number, missed):
    clock, ticker = make()
    ticker.wait()
    clock.now += stall_ms * MS
    tick = ticker.wait()
    assert (tick.number, tick.missed) == (number, missed)
    following = ticker.wait()
    assert (following.number, following.missed) == (number + 1, 0)
    assert following.now_ns == 1_000 * MS + (number + 1) * 10 * MS
    assert ticker.missed == missed


def test_a_sleep_that_ends_early_is_repeated():
    clock = Clock(1_000 * MS)

    def short(seconds):
        clock.sleep(min(seconds, 0.004))

    ticker = Ticker(10 * MS, clock, short)
    ticker.wait()
    assert ticker.wait().now_ns == 1_010 * MS
    assert clock.sleeps == 3


def test_lateness_is_counted_per_tick():
    clock, ticker = make()
    clock.late_ns = 300_000
    for _ in range(10):
        ticker.wait()
    assert ticker.lateness.total == 10
    assert ticker.lateness.largest == 300_000


def test_period_must_be_positive():
    with pytest.raises(ValueError, match="period_ns"):
        Ticker(0)


def test_histogram_quantile_is_a_bound_within_a_quarter():
    histogram = Histogram()
    values = [k * k * 37 for k in range(1, 1001)]
    for value in values:
        histogram.count(value)
    for fraction in (0.01, 0.5, 0.9, 0.99, 1.0):
        exact = values[max(round(fraction * 1000) - 1, 0)]
        assert exact <= histogram.quantile(fraction) <= exact * 1.25


def test_histogram_small_values_are_exact_and_odd_values_are_safe():
    histogram = Histogram()
    assert histogram.quantile(0.99) == 0
    for value in range(8):
        histogram.count(value)
    assert [histogram.quantile((k + 1) / 8) for k in range(8)] == list(range(8))
    histogram.count(-5)
    assert histogram.counts[0] == 2
    histogram.count(1 << 70)
    assert histogram.quantile(1.0) <= 1 << 70


def test_histogram_never_grows():
    histogram = Histogram()
    size = len(histogram.counts)
    for bit in range(64):
        histogram.count(1 << bit)
        histogram.count((1 << bit) - 1)
    assert len(histogram.counts) == size
    assert sum(histogram.counts) == histogram.total == 128


def largest(timing):
    return {name: h.largest for name, h in timing.stages.items()}


def test_the_stages_of_a_tick_add_up():
    timing = Timing(Histogram())
    timing.record(1 * MS, woken=4 * MS, read=5 * MS, stepped=9 * MS, sent=11 * MS)
    assert largest(timing) == dict(
        zip(STAGES, (3 * MS, 1 * MS, 4 * MS, 2 * MS, 10 * MS), strict=True)
    )
    assert timing.latency.total == 1


def test_a_frame_may_come_while_the_tick_begins():
    timing = Timing(Histogram())
    timing.record(5 * MS, woken=4 * MS, read=6 * MS, stepped=7 * MS, sent=8 * MS)
    assert largest(timing) == dict(zip(STAGES, (0, 1 * MS, 1 * MS, 1 * MS, 3 * MS), strict=True))


def test_a_tick_that_decides_nothing_new_is_not_counted():
    timing = Timing(Histogram())
    timing.record(None, 1, 2, 3, 4)
    assert timing.latency.total == 0
    timing.record(1, 2, 3, 4, 5)
    timing.record(1, 12, 13, 14, 15)
    assert timing.latency.total == 1
    timing.record(11, 12, 13, 14, 15)
    assert timing.latency.total == 2


def test_octaves_hold_every_value_once():
    histogram = Histogram()
    values = np.random.default_rng(3).integers(0, 5000, 400).tolist()
    for value in values:
        histogram.count(value)
    octaves = histogram.octaves()
    assert [a for a, _, _ in octaves[1:]] == [b for _, b, _ in octaves[:-1]]
    for begin, below, count in octaves:
        assert count == sum(begin <= value < below for value in values)
    assert sum(count for _, _, count in octaves) == 400
    assert Histogram().octaves() == []


@pytest.mark.parametrize("decided", [[], [0, 2 * MS]])
def test_the_report_says_what_the_histograms_hold(tmp_path, decided):
    timing = Timing(Histogram())
    for k, stamp in enumerate(decided):
        timing.lateness.count(100_000)
        begin = stamp + (k + 1) * MS
        timing.record(stamp, begin, begin + 10_000, begin + 400_000, begin + 500_000)
    leave(tmp_path, Timed(timing.stage_rows(), 10 * MS, 2, 0), "Timing of a test")
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
    else:
        assert "| frame to flag | 0 | - | - | - | - | - |" in text
    assert "data:image/svg+xml" in (tmp_path / "report.html").read_text()
    drawn = ET.parse(tmp_path / "timing.svg").getroot()
    bars = [part for part in drawn.iter() if part.tag.endswith("rect") and part.get("fill")]
    octaves = [max(below, 1024) for stage in timing.stage_rows() for _, below, _ in stage.octaves]
    assert len(bars) <= len(octaves)
    assert bool(bars) == bool(decided)
    titles = "".join(drawn.itertext())
    assert all(f"{name}: {len(decided)} ticks" in titles for name in counted)


def test_the_picture_of_the_timing_needs_no_library_for_pictures(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    timing = Timing(Histogram())
    timing.lateness.count(100_000)
    leave(tmp_path, Timed(timing.stage_rows(), 10 * MS, 1, 0), "Timing of a test")
    assert "lateness: 1 ticks" in (tmp_path / "timing.svg").read_text()
