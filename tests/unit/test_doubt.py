"""What is known against all flags at once: how long it is held, and which reason goes first."""

from __future__ import annotations

import pytest

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, SECOND, Frame
from gateway.commands.run import active_errors
from gateway.doubt import INTRUDER_HOLD_NS, Doubt
from gateway.drivers.canopen_node import GatewayError
from gateway.drivers.pythoncan import PythonCan
from gateway.health import Flag, GatewayState, Reason
from tests.sender import codec_for
from tests.unit.test_core import TICK, Bench, drives, gateway, named

OWN = codec_for().by_name["Gateway_Adhesion"].can_id


def told(*notes, ticks=1):
    doubt = Doubt(TICK)
    for k in range(ticks):
        for note in notes:
            note(doubt)
        doubt.tick(k * TICK, 0)
    return doubt


def test_nothing_is_known_at_the_start():
    assert told().reason is Reason.NONE
    assert not told().overrun


def test_late_ticks_count_when_they_come_in_a_row():
    late = lambda doubt: doubt.note_overrun(2)  # noqa: E731
    assert told(late, ticks=3).reason is Reason.NONE
    assert told(late, ticks=4).reason is Reason.OVERRUN
    assert told(late, ticks=4).deadline_misses == 8
    doubt = told(late, ticks=4)
    doubt.tick(4 * TICK, 0)
    assert doubt.reason is Reason.NONE
    assert doubt.overrun
    doubt.tick(3 * TICK + SECOND, 0)
    assert doubt.overrun
    doubt.tick(4 * TICK + SECOND, 0)
    assert not doubt.overrun


def test_a_tick_in_time_ends_the_row():
    doubt = told()
    for k, wanted in enumerate([Reason.NONE] * 3 + [Reason.OVERRUN] * 2, start=1):
        doubt.note_overrun(1)
        doubt.tick(k * TICK, 0)
        assert doubt.reason is wanted


@pytest.mark.parametrize("begin", [0, 7 * TICK, 12_345_678_901])
def test_how_long_lost_frames_count_depends_on_no_clock(begin):
    doubt = Doubt(TICK)
    doubt.note_lost(3)
    said = []
    for k in range(8):
        doubt.tick(begin + k * TICK, 0)
        said.append(doubt.reason)
    assert said == [Reason.SEQUENCE] * 5 + [Reason.NONE] * 3


def test_lost_frames_are_held_against_every_flag_for_five_ticks():
    doubt = told(lambda doubt: doubt.note_lost(1))
    for k in range(1, 5):
        doubt.tick(k * TICK, 0)
        assert doubt.reason is Reason.SEQUENCE
    doubt.tick(5 * TICK, 0)
    assert doubt.reason is Reason.NONE


@pytest.mark.parametrize("at", [TICK, 7 * SECOND])
def test_there_is_no_doubt_once_what_was_noted_is_long_past(at):
    fresh = told()
    assert fresh.none(0)
    for note, held in (
        (lambda doubt: doubt.note_overrun(1), SECOND),
        (lambda doubt: doubt.note_lost(1), 5 * TICK),
    ):
        doubt = Doubt(TICK)
        note(doubt)
        doubt.tick(at, 0)
        assert doubt.none(at + held + 1) == (held != SECOND), "a late tick, and none behind it yet"
        doubt.tick(at + TICK, 0)
        assert not any(doubt.none(at + since) for since in (TICK, held - 1, held))
        assert doubt.none(at + held + 1)
        note(doubt)
        assert not doubt.none(at + held + 1), "not looked at yet"


def test_who_watches_or_has_seen_an_intruder_is_never_without_doubt():
    watching, seen = told(), told()
    watching.watching = seen.watching = True
    assert not watching.none(0)
    seen.tick(TICK, 1)
    seen.watching = False
    assert not seen.none(9 * SECOND)


def test_an_intruder_is_known_only_to_who_watches_and_is_never_forgotten():
    doubt = Doubt(TICK)
    doubt.tick(0, 3)
    assert not doubt.intruder
    doubt.watching = True
    doubt.tick(TICK, 0)
    assert not doubt.intruder
    doubt.tick(2 * TICK, 1)
    doubt.note_lost(1)
    for k in range(3, 1000):
        doubt.note_overrun(1)
        doubt.tick(k * TICK, 0)
    assert doubt.reason is Reason.INTRUDER


@pytest.mark.parametrize(("options", "echo"), [
    ({"interface": "virtual"}, False),
    ({"interface": "virtual", "receive_own_messages": True}, True),
    ({"interface": "udp_multicast"}, True),
])  # fmt: skip
def test_a_bus_that_gives_back_what_is_sent_says_so(options, echo):
    assert PythonCan(options).status.hears_itself is echo


def test_unknown_lasts_as_long_as_the_intruder_and_ten_seconds_more():
    doubt = Doubt(TICK, intruder_hold_ns=INTRUDER_HOLD_NS)
    doubt.watching = True
    for k in range(300):
        doubt.tick(k * TICK, int(k % 100 == 0))
        assert doubt.reason is Reason.INTRUDER
    doubt.tick(200 * TICK + 10 * SECOND, 0)
    assert doubt.reason is Reason.INTRUDER
    doubt.tick(201 * TICK + 10 * SECOND, 0)
    assert doubt.reason is Reason.NONE
    assert doubt.intruder, "it was there, all the same"
    doubt.tick(60 * SECOND, 1)
    assert doubt.reason is Reason.INTRUDER, "it is back"


def with_own(frames, now):
    return [*frames, Frame(now, OWN, bytes(8))]


def running(**sections):
    bench = Bench(gateway(**sections), drives((20.0, 8.0, 20.0)))
    bench.core.doubt.watching = True
    view = bench.run(60)
    assert [d.adhesion for d in view.drives] == [Flag.GOOD, Flag.BAD, Flag.GOOD]
    return bench


@pytest.mark.parametrize(
    ("frame", "is_ours"),
    [
        (Frame(0, OWN, b""), True),
        (Frame(0, OWN, bytes(8)), True),
        (Frame(0, OWN, bytes(64), FD), True),
        (Frame(0, 0x720, b"\x05"), True),
        (Frame(0, 0x0A0, bytes(8)), True),
        (Frame(0, 0x501, bytes(8)), True),
        (Frame(0, OWN, bytes(8), ERROR), False),
        (Frame(0, OWN, bytes(8), EXTENDED), False),
        (Frame(0, OWN, b"", REMOTE, "", 8), False),
        (Frame(0, 0x721, b"\x05"), False),
        (Frame(0, 0x511, bytes(8)), False),
    ],
)
def test_what_counts_as_a_frame_of_ours(frame, is_ours):
    bench = running()
    view = bench.run(1, lambda frames, now: [*frames, frame._replace(t_ns=now)])
    assert (view.adhesion_reason is Reason.INTRUDER) == bench.core.doubt.intruder == is_ours


@pytest.mark.parametrize("sections", [{}, {"bus": {"on_intruder": "unknown"}}])
def test_one_foreign_frame_makes_flags_unknown_for_ten_seconds_and_comm_bad_for_good(sections):
    bench = running(**sections)
    for k in range(1, 1200):
        view = bench.run(1, with_own if k in (1, 101) else lambda frames, _now: frames)
        flags = [d.adhesion for d in view.drives]
        sent = named(bench.sent)
        assert view.comm is Flag.BAD
        assert sent.get("Gateway_Faults", {"CommFault": 2})["CommFault"] == 2
        said = [sent["Gateway_Adhesion"][f"Adhesion{n}"] for n in (1, 2, 3)]
        if k <= 1101:
            assert flags == [Flag.UNKNOWN, Flag.BAD, Flag.UNKNOWN], "unknown does not clear bad"
            assert sent["Gateway_Adhesion"]["Reason"] == 10
            assert said == [0, 2, 0]
            assert {d.thermal for d in view.drives} == {Flag.UNKNOWN}
        if k > 1101 + 10:
            assert said == [1, 2, 1]
            assert view.state is GatewayState.RUNNING
    assert GatewayError.INTRUDER in active_errors(bench.core)


def test_who_stops_falls_silent_for_good_at_one_foreign_frame():
    bench = running(bus={"on_intruder": "stop"})
    view = bench.run(1, with_own)
    assert view.comm is Flag.BAD
    assert view.adhesion_reason is Reason.INTRUDER
    frames = named(bench.sent)
    assert frames["Gateway_Adhesion"]["Reason"] == 10
    said = [frames["Gateway_Adhesion"][f"Adhesion{n}"] for n in (1, 2, 3)]
    assert said == [0, 2, 0]  # unknown does not clear bad
    for _ in range(500):
        view = bench.run(1)
        assert bench.sent == []
    assert view.state is GatewayState.SILENT
    assert bench.core.unknown_frames(bench.tick * TICK) == []
    assert GatewayError.INTRUDER in active_errors(bench.core)


def test_who_goes_on_says_intruder_and_nothing_good():
    bench = running(bus={"on_intruder": "go_on"})
    bench.run(1, with_own)
    for _ in range(500):
        view = bench.run(1)
        assert [d.adhesion for d in view.drives] == [Flag.UNKNOWN, Flag.BAD, Flag.UNKNOWN]
        assert named(bench.sent)["Gateway_Adhesion"]["Reason"] == 10
    assert {d.thermal for d in view.drives} == {Flag.UNKNOWN}
    assert view.faults_reason is Reason.INTRUDER
    assert view.common_mode is Flag.UNKNOWN
    assert view.comm is Flag.BAD


def test_in_a_log_our_own_frames_are_no_intruders():
    bench = Bench(gateway(), drives())
    view = bench.run(60, with_own)
    assert {d.adhesion for d in view.drives} == {Flag.GOOD}
    assert bench.core.inbox.counts["own"] == 60


def test_lost_frames_make_good_unknown_for_five_ticks():
    bench = Bench(gateway(), drives())
    bench.run(60)
    bench.core.doubt.note_lost(40)
    for _ in range(5):
        view = bench.run(1)
        assert {d.adhesion for d in view.drives} == {Flag.UNKNOWN}
        assert view.adhesion_reason is Reason.SEQUENCE
        assert view.common_mode is Flag.UNKNOWN
    view = bench.run(10)
    assert {d.adhesion for d in view.drives} == {Flag.GOOD}
    assert view.common_mode is Flag.GOOD


def test_an_allowed_word_is_asked_for():
    with pytest.raises(ValueError, match="on_intruder"):
        gateway(bus={"on_intruder": "fight"})
