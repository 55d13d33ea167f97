"""What speaks against all flags at once, in a whole gateway: lost frames, a second gateway."""

import pytest

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from gateway.commands.run import active_errors
from gateway.core.codes import Flag, GatewayState, Reason
from gateway.io.canopen_node import GatewayError
from gateway.io.pythoncan import PythonCan
from tests.sender import codec_for
from tests.unit.test_core import TICK, Bench, drives, gateway, named

OWN = codec_for().by_name["Gateway_Adhesion"].can_id


@pytest.mark.parametrize(("options", "echo"), [
    ({"interface": "virtual"}, False),
    ({"interface": "virtual", "receive_own_messages": True}, True),
    ({"interface": "udp_multicast"}, True),
])  # fmt: skip
def test_a_bus_that_gives_back_what_is_sent_says_so(options, echo):
    assert PythonCan(options).status.hears_itself is echo


def with_own(frames, now):
    return [*frames, Frame(now, OWN, bytes(8))]


def running(**sections):
    bench = Bench(gateway(**sections), drives((20.0, 8.0, 20.0)))
    bench.core.integrity.watching = True
    view = bench.run(60)
    assert [d.adhesion for d in view.drives] == [Flag.GOOD, Flag.BAD, Flag.GOOD]
    return bench


@pytest.mark.parametrize(
    ("frame", "is_ours"),
    [
        (Frame(0, OWN, b""), True), (Frame(0, OWN, bytes(8)), True),
        (Frame(0, OWN, bytes(64), FD), True), (Frame(0, 0x720, b"\x05"), True),
        (Frame(0, 0x0A0, bytes(8)), True), (Frame(0, 0x501, bytes(8)), True),
        (Frame(0, OWN, bytes(8), ERROR), False), (Frame(0, OWN, bytes(8), EXTENDED), False),
        (Frame(0, OWN, b"", REMOTE, "", 8), False), (Frame(0, 0x721, b"\x05"), False),
        (Frame(0, 0x511, bytes(8)), False),
    ],
)  # fmt: skip
def test_what_counts_as_a_frame_of_ours(frame, is_ours):
    bench = running()
    view = bench.run(1, lambda frames, now: [*frames, frame._replace(t_ns=now)])
    assert (view.adhesion_reason is Reason.INTRUDER) == bench.core.integrity.intruder == is_ours


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
    bench.core.integrity.note_lost(40)
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
