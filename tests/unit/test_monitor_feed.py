"""The feed: pictures, points of traces, what viewers may ask, events to the log."""

import asyncio
import json
import logging

import pytest

from gateway.monitor.feed import FASTEST, LONGEST_S, Feed, Picture, added
from gateway.monitor.model.snapshot import Event
from tests.watched import FakeSource, snapshot


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def feed_of(**options):
    clock = Clock()
    source = FakeSource(live=options.pop("live", False), make=options.pop("make", snapshot))
    return Feed(source, clock=clock, **options), source, clock


def event(k, level="info"):
    return Event(float(k), level, 1, f"event {k}")


def test_time_passes_as_the_clock_says_but_never_jumps():
    feed, source, clock = feed_of()
    feed.look()
    clock.now += 0.25
    feed.look()
    clock.now += 100.0
    feed.look()
    clock.now -= 1.0
    feed.look()
    assert source.log == [
        ("advance", 0.0),
        ("advance", 0.25),
        ("advance", LONGEST_S),
        ("advance", 0.0),
    ]


def test_a_log_waits_for_the_first_viewer_where_told_to():
    feed, source, clock = feed_of(waits=True)
    clock.now += 0.2
    feed.look()
    feed.viewers = 1
    clock.now += 0.2
    feed.look()
    assert [round(dt, 3) for _, dt in source.log] == [0.0, 0.2]


def test_what_a_viewer_may_ask():
    feed, source, _ = feed_of()
    for good in ({"seek": 12.5}, {"seek": 0}, {"pause": True}, {"speed": 2}):
        assert feed.ask(good), good
    feed.look()
    assert source.log == [("seek", 0.0)], "of several only the last"
    assert (source.paused, source.speed) == (True, 2.0)
    for bad in (
        None, [], "seek", {}, {"seek": "1"}, {"seek": True}, {"seek": float("nan")},
        {"seek": float("inf")}, {"seek": -1}, {"pause": 1}, {"pause": None}, {"speed": -1},
        {"speed": []}, {"send": "181#00"}, {"seek": 1, "pause": True}, {"close": True},
        {"_source": 1}, 7,
    ):  # fmt: skip
        assert not feed.ask(bad), bad
    feed.look()
    assert source.log[-1][0] == "advance"
    feed.ask({"speed": 1e9})
    feed.look()
    assert source.speed == FASTEST


def test_of_a_bus_nothing_can_be_asked():
    feed, source, _ = feed_of(live=True)
    for wish in ({"seek": 1.0}, {"pause": True}, {"speed": 5}):
        assert feed.ask(wish), "a page that asks is no fault"
    feed.look()
    assert [kind for kind, _ in source.log] == ["advance"]
    assert (source.paused, source.speed) == (False, 1.0)


def message(picture, before=None):
    return json.loads(picture.message(before))


def picture(t_s, **more):
    return Picture(1, snapshot(t_s, **more), {"title": "x"})


def test_the_first_message_has_everything():
    got = message(picture(1.0, events=(event(1),)))
    assert set(got) == {"head", "events", "points"}
    assert got["head"]["title"] == "x"
    assert got["head"]["drives"][0]["adhesion"] == "Adhering"
    assert got["head"]["drives"][1]["speed_rad_s"] is None
    assert "history" not in got["head"]
    assert "events" not in got["head"]
    assert got["events"] == [{"t_s": 1.0, "level": "info", "drive": 1, "text": "event 1"}]
    points = got["points"]
    assert points["fresh"]
    assert points["t_s"] == [k / 10 for k in range(1, 11)]
    assert points["drives"]["2"]["load_nm"] == [None, *[0.1235] * 9]
    assert points["drives"]["2"]["adhesion"] == ["Unknown", *["Adhering"] * 9]


def test_later_ones_have_what_is_new():
    before = picture(1.0)
    assert set(message(picture(1.0), before)) == {"head"}
    got = message(picture(1.3), before)
    assert set(got) == {"head", "points"}
    assert not got["points"]["fresh"]
    assert got["points"]["t_s"] == [1.1, 1.2, 1.3]
    assert len(got["points"]["drives"]["1"]["adhesion"]) == 3
    assert set(message(picture(1.0, events=(event(1),)), before)) == {"head", "events"}


def test_who_missed_more_than_the_traces_hold_or_went_back_gets_all_of_them():
    for other in (5.0, 0.2):
        got = message(picture(other, points=2), picture(1.0))["points"]
        assert got["fresh"], other
        assert len(got["t_s"]) == 2


def test_a_slow_viewer_misses_pictures_but_no_points():
    had, kept = None, []
    for t in (1.0, 1.1, 1.6, 1.7, 2.4):
        shown = picture(t)
        points = message(shown, had)["points"]
        kept = points["t_s"] if points["fresh"] else kept + points["t_s"]
        had = shown
    assert kept == [k / 10 for k in range(1, 25)]


def test_before_the_first_frame_there_are_no_points():
    shown = Picture(1, snapshot(0.0, history=()), {})
    assert shown.last_s is None
    assert message(shown)["points"] == {"fresh": True, "t_s": [], "drives": {}}
    assert message(picture(1.0), shown)["points"]["fresh"]


@pytest.mark.parametrize("gone", [0, 1, 4])
@pytest.mark.parametrize("new", [0, 1, 3, 9])
def test_new_events_are_found_though_old_ones_go(gone, new):
    before = tuple(event(k) for k in range(5))
    after = (*before[gone:], *(event(k) for k in range(5, 5 + new)))
    assert [e.t_s for e in added(before, after)] == [float(k) for k in range(5, 5 + new)]


def test_events_go_to_the_log_by_their_level(caplog):
    told = [()]
    feed, _, _ = feed_of(live=True, make=lambda t_s: snapshot(t_s, events=told[-1]))
    with caplog.at_level(logging.INFO, logger="gateway.monitor.feed"):
        feed.look()
        for k, level in enumerate(("info", "warning", "error"), 1):
            told.append((*told[-1], event(k, level)))
            feed.look()
            feed.look()
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("INFO", "drive 1: event 1"),
        ("WARNING", "drive 1: event 2"),
        ("ERROR", "drive 1: event 3"),
    ]
    assert caplog.records[2].drive == 1
    assert caplog.records[2].t_s == 3.0
    assert feed.happened == {"info": 1, "warning": 1, "error": 1}
    lines = {(r.pathname, r.lineno) for r in caplog.records}
    assert len(lines) == 3, "the log's limit counts by place: errors have one of their own"


def test_what_a_seek_jumps_over_is_not_told(caplog):
    def make(t_s):
        return snapshot(t_s, events=tuple(event(k) for k in range(1, int(t_s) + 1)))

    feed, _, clock = feed_of(make=make)
    with caplog.at_level(logging.INFO, logger="gateway.monitor.feed"):
        feed.look()  # as far as the log was gone into at the start
        feed.ask({"seek": 30})
        feed.look()
        assert not caplog.records
        for _ in range(3):
            clock.now += 0.5
            feed.look()
    assert [r.getMessage() for r in caplog.records] == ["drive 1: event 31"]


def test_the_feed_wakes_viewers_and_says_little_while_nothing_changes():
    feed, source, _ = feed_of()
    source.paused = True

    async def run():
        job = asyncio.create_task(feed.play())
        first = await asyncio.wait_for(feed.after(None), 5)
        second = await asyncio.wait_for(feed.after(first), 5)
        job.cancel()
        await asyncio.gather(job, return_exceptions=True)
        return first, second

    first, second = asyncio.run(run())
    assert not second.differs(first)
    assert second.number - first.number > 3, "a sign of life, not every look"


def test_what_a_look_raises_comes_out():
    def broken(_):
        raise RuntimeError("broken")

    feed, _, _ = feed_of(make=broken)
    with pytest.raises(RuntimeError, match="broken"):
        asyncio.run(feed.play())
