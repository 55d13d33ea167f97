"""The parts of a report, by law: envelopes, intervals, truth, TOML, Markdown, pictures."""

import re
import tomllib
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from gateway.core.codes import REJECTED, Flag, GatewayState, Reason
from gateway.core.receiving import NAMES
from gateway.core.view import DriveView, GatewayView
from gateway.reports import words
from gateway.reports.figures import Panel, panels, save, styled
from gateway.reports.intervals import KEPT, Interval, Intervals
from gateway.reports.page import Anchors, code, literal, plain, table
from gateway.reports.provenance import as_toml
from gateway.reports.scoring import Judged, first, judge, summary_table
from gateway.reports.trace import CHUNK, MOST, Envelope, Trace
from gateway.reports.truth import HEADER, Event, read, rows
from gateway.settings.config import Config, ConfigError, load, parse
from sim.ground_truth import COLUMNS
from tests.ticked import ticks

GOLDEN = Path(__file__).parents[1] / "golden"


def view(t_ns, *drives, load=50.0):
    return GatewayView(
        t_ns, drives, 1, Flag.UNKNOWN, None, Reason.NONE, Reason.NONE, Flag.GOOD, Flag.GOOD,
        Flag.GOOD, Flag.GOOD, GatewayState.RUNNING, 0, 0, 0, load, None, None,
    )  # fmt: skip


@pytest.mark.parametrize("ticks", [1, 7, CHUNK - 1, CHUNK, MOST, MOST + 1, 3 * MOST + 5, 40_000])
def test_an_envelope_keeps_every_smallest_and_largest_value(ticks):
    random = np.random.default_rng(ticks)
    values = random.normal(size=(ticks, 2))
    values[random.random(ticks) < 0.3, 1] = np.nan
    envelope = Envelope(2)
    rows = np.column_stack([np.arange(float(ticks)), values])
    # A few at a time, and many.
    for part in np.split(rows, sorted(random.integers(0, ticks + 1, 20))):
        envelope.add_rows(part)
    width = envelope.width if envelope.curve(0) else 0
    for column in (0, 1):
        curve = envelope.curve(column)
        assert len(curve.t_s) <= MOST
        starts = range(0, ticks, width)
        assert curve.t_s.tolist() == list(starts)
        for k, a in enumerate(starts):
            mine = values[a : a + width, column]
            known = mine[np.isfinite(mine)]
            wanted = (known.min(), known.max()) if len(known) else (np.nan, np.nan)
            np.testing.assert_array_equal((curve.low[k], curve.high[k]), wanted)
    assert ticks < MOST or envelope.used > MOST // 2 - 1


def test_an_envelope_of_days_is_no_larger_than_one_of_minutes():
    """Stretches of several chunks as well; the one tick that differs is still there."""
    envelope = Envelope(1)
    ticks, spike = 5 * MOST * CHUNK // 2 + 3, 1_000_003
    for begin in range(0, ticks, 1000):
        t_s = np.arange(begin, min(begin + 1000, ticks), dtype=float)
        envelope.add_rows(np.column_stack([t_s, 9.0 * (t_s == spike)]))
    curve = envelope.curve(0)
    assert envelope.width > CHUNK
    assert len(curve.t_s) <= MOST
    (place,) = np.flatnonzero(curve.high == 9.0)
    assert curve.t_s[place] <= spike < curve.t_s[place] + envelope.width
    assert curve.low.tolist() == [0.0] * len(curve.low)
    assert curve.t_s.tolist() == list(range(0, ticks, envelope.width))


def test_a_trace_may_be_looked_at_while_it_grows():
    trace = Trace((4, 2))
    for k in range(5):
        both = DriveView(4, load_nm=1.0 * k), DriveView(2, mixed_c=30.0)
        trace.add_ticks(ticks(view(k * 10**7, *both)))
        assert trace.curve(4, "load_nm").high.tolist() == [float(n) for n in range(k + 1)]
    assert not trace.curve(2, "load_nm").known
    assert trace.curve(2, "mixed_c").known
    assert trace.span_s == 0.04
    assert trace.bus_load == (50.0, 50.0, 50.0)


flags = st.lists(st.sampled_from(list(Flag)), min_size=1, max_size=60)


@given(flags)
def test_intervals_cover_the_run_without_gap_or_overlap(said):
    intervals = Intervals((1,))
    views = [
        view(k, DriveView(1, adhesion=flag, adhesion_reason=Reason.STALE))
        for k, flag in enumerate(said)
    ]
    # Several ticks at once and one by one are the same.
    intervals.add_ticks(ticks(*views[: len(views) // 2 + 1]))
    for one in views[len(views) // 2 + 1 :]:
        intervals.add_ticks(ticks(one))
    intervals.close()
    mine = [i for i in intervals.kept if i.flag == "adhesion"]
    assert mine[0].start_ns == 0
    assert mine[-1].end_ns == len(said) - 1
    for before, after in pairwise(mine):
        assert before.end_ns == after.start_ns
        assert before.state != after.state
    words_ = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "Adhering", Flag.BAD: "AdhesionLost"}
    for i in mine:
        inside = said[i.start_ns : max(i.end_ns, i.start_ns + 1)]
        assert {words_[flag] for flag in inside} == {i.state}


def test_a_flag_that_never_rests_is_counted_but_not_kept_for_ever():
    intervals = Intervals((1,))
    count = 2 * KEPT + 20
    intervals.add_ticks(ticks(*(
        view(k, DriveView(1, adhesion=Flag.BAD if k % 2 else Flag.UNKNOWN)) for k in range(count)
    )))  # fmt: skip
    intervals.close()
    assert intervals.count[1, "adhesion", "AdhesionLost"] == count // 2
    assert intervals.left_out() == {
        ("adhesion", "AdhesionLost"): 10, ("adhesion", "Unknown"): 10,
    }  # fmt: skip
    assert sum(i.flag == "adhesion" for i in intervals.kept) == 2 * KEPT


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(1, 60)), max_size=4),
    st.lists(st.integers(0, 400), max_size=12),
)
def test_a_delay_runs_to_the_first_change_to_lost_in_a_loss(losses, changes):
    """The same rule, said by the changes of the flag instead of by its intervals."""
    events = []
    last = -1
    for start, length in sorted(losses):
        if start > last:
            last = start + length
            events.append(Event(1, "adhesion", "loss", start / 100, last / 100))
    ms = 10_000_000
    # Half a tick beside the truth's grid: nothing happens at one and the same instant.
    edges = [t + 0.5 for t in sorted(set(changes))]
    intervals = [
        Interval(
            1, "adhesion", ("AdhesionLost", "Adhering")[k % 2], round(t * ms), round(u * ms), ()
        )
        for k, (t, u) in enumerate(pairwise([*edges, 500]))
    ]
    raised = [t / 100 for t in edges[::2]]

    def delay(event):
        if sum(t / 100 < event.start_s for t in edges) % 2:
            return 0.0
        return next(
            ((t - event.start_s) * 1e3 for t in raised if event.start_s < t < event.end_s), None
        )

    judged, false = judge(events, intervals, 0)
    assert [j.delay_ms for j in judged] == pytest.approx([delay(event) for event in events])
    for i in intervals:
        near = any(i.start_ns / 1e9 <= e.end_s + 0.03 and i.end_ns / 1e9 >= e.start_s
                   for e in events)  # fmt: skip
        assert (i in false) == (i.bad and not near)


def test_the_summary_of_losses_has_median_and_worst_delay_of_each_drive():
    loss = Event(2, "adhesion", "loss", 1.0, 2.0)
    lines = summary_table([Judged(loss, None, d) for d in (None, 30.0, 10.0, 20.0)], (1, 2))
    assert [line.split() for line in lines.splitlines()[1:]] == [
        ["1", "0", "0", "-", "-"], ["2", "4", "3", "20", "30"],
    ]  # fmt: skip


@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from(Flag))), st.integers(-1, 35))
def test_the_first_frame_of_a_state_from_a_time_on(steps, at):
    seen = list(zip(accumulate(dt for dt, _ in steps), [flag for _, flag in steps], strict=True))
    for wanted in Flag:
        later = [t for t, flag in seen if t >= at and flag is wanted]
        assert first(seen, wanted, at) == min(later, default=None)


def truth_file(path, *lines):
    path.write_text("\n".join([",".join(HEADER), *lines]) + "\n")
    return path


def test_truth_is_read_on_the_logs_clock_or_from_its_first_frame(tmp_path):
    path = truth_file(
        tmp_path / "t.csv", "0.01,1,1,0,9,0,1,0", "0.02,1,1,0,9,1,1,0", "0.03,1,1,0,9,0,2,0",
        "0.04,1,1,0,9,0,6,0",
    )  # fmt: skip
    truth, same = read(path, 0.005, 1.0)
    assert same
    assert [(e.flag, e.kind) for e in truth.events] == [
        ("adhesion", "loss"), ("thermal", "Overheating"), ("sensor", "SensorStuck"),
    ]  # fmt: skip
    assert truth.events[0].start_s == pytest.approx(0.015)
    assert truth.events[0].end_s == pytest.approx(0.025)
    away, same = read(path, 1.7e9, 1.7e9 + 5)
    assert not same
    assert away.events[0].start_s == pytest.approx(0.02)
    assert away.load(7) is None


@pytest.mark.parametrize(
    ("cut", "creep", "says"),
    [("1", "0.05", True), ("0", "0.05", False), ("1", "-0.3", False), ("1", "", False)],
)
def test_a_loss_in_which_the_drive_cut_its_torque_and_never_slid_is_cut(tmp_path, cut, creep, says):
    """`cut` is never the word for a wheel that slides, nor where nobody knows whether it does."""
    path = tmp_path / "t.csv"
    lines = [
        f"0.01,1,1,0,9,0,1,0,{cut},9,20",
        *(f"{t},1,1,0,9,1,1,0,{cut},{creep},20" for t in (0.02, 0.03)),
        "0.04,1,1,0,9,0,1,0,0,9,20", "0.05,1,1,0,9,1,1,0,0,0,20", "0.06,1,1,0,9,0,1,0,0,0,20",
    ]  # fmt: skip
    path.write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    truth, _ = read(path, 0.005, 1.0)
    assert [(e.kind, e.cut) for e in truth.events] == [("loss", says), ("loss", False)]


@pytest.mark.parametrize(
    "line", ["1,2", "x,1,1,0,9,0,1,0", "nan,1,1,0,9,0,1,0", "0,1,1,0,9,0,99,0", "0,1,1,0,inf,0,1,0"]
)
def test_what_is_no_row_of_truth_is_told_with_its_line(tmp_path, line):
    path = truth_file(tmp_path / "t.csv", "0.01,1,1,0,9,0,1,0", line)
    with pytest.raises(ConfigError, match="line 3"):
        list(rows(path))
    path.write_text("something else\n")
    with pytest.raises(ConfigError, match="first line"):
        read(path, 0, 1)
    with pytest.raises(ConfigError, match="no row"):
        read(truth_file(path), 0, 1)


def test_a_configuration_as_toml_is_the_same_configuration():
    odd = {
        "drive": [{"node": 3, "motor": 'a b\n"\\\x7f\u00e9'}],
        "motor": {'a b\n"\\\x7f\u00e9': Config().motors["bench"].model_dump()},
        "authentication": {"key": "k"},
    }
    examples = GOLDEN.parents[1] / "examples"
    files = [examples / "train16.toml", *sorted((examples / "inverters").glob("*.toml"))]
    assert len(files) == 8
    for config in (Config(), parse(odd), *map(load, files)):
        text = as_toml(config)
        again = parse(tomllib.loads(text), config.source, config.base, config.text)
        assert again == config
        assert again.hash24() == config.hash24()


TEXT = "ab <&>`*_|\\[]!#-+=\n\x1b\u00e9~^{}$.1)"


@settings(max_examples=300)
@given(st.text(TEXT, max_size=12))
def test_somebody_elses_words_are_shown_as_they_are(text):
    from dbc.text import printable

    said = printable(text)
    reader = MarkdownIt("commonmark").enable("table")
    page = reader.render("\n".join(table(("a", "b"), [(f"x{plain(text)}y", literal(text))])))
    cells = re.findall(r"<td>(.*?)</td>", page, re.DOTALL)
    assert len(cells) == 2
    import html

    assert html.unescape(cells[0]) == f"x{said}y"
    assert "<" not in cells[0]
    inner = cells[1].removeprefix("<code>").removesuffix("</code>")
    assert html.unescape(inner).strip() == said.strip()
    heading = reader.render(f"# {plain(text)}")
    assert "<" not in heading.replace("<h1>", "").replace("</h1>", "")


def test_code_ends_where_it_ends():
    text = "a\n```\n<b>\n`````\n"
    page = MarkdownIt("commonmark").render("\n".join(code(text, "toml")))
    assert page.count("<code") == 1
    assert "&lt;b&gt;" in page


def test_headings_of_the_same_name_have_names_of_their_own():
    anchors = Anchors()
    assert [anchors.anchor_of(h) for h in ("Drive 1", "Drive 1", "A: b/c")] == [
        "drive-1", "drive-1-1", "a-bc",
    ]  # fmt: skip


def test_every_counter_and_reason_has_words():
    assert set(NAMES) | {
        "received", "translated", "canopen", "unknown_id", "unpaired", "late", "left_out",
    } == set(words.COUNTS)  # fmt: skip
    assert set(REJECTED) <= set(words.NOT_USED) <= set(words.COUNTS)
    assert set(words.REASONS) == set(Reason) - {Reason.NONE}


def test_a_picture_has_no_date_and_no_reference(tmp_path):
    for name in ("a.svg", "b.svg"):
        with styled():
            figure, axes = panels([Panel(1.0, "y"), Panel(1.0, "z")])
            axes[0].fill_between([0.0, 1.0], [0.0, 0.123456789], [1.0, 1.0], hatch="//")
            save(figure, tmp_path / name)
    text = (tmp_path / "a.svg").read_text()
    assert (tmp_path / "b.svg").read_text() == text
    assert set(re.findall(r"https?://[^\"' ]*", text)) <= {
        "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink",
    }  # fmt: skip
    assert "<text" in text
