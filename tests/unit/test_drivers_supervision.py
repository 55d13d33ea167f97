"""Heartbeat supervision and the emergency log."""

import struct

import pytest

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, Frame
from gateway.core.supervision import Life, NodeState, Supervision
from tests.stations import any_lost

TIMEOUT = 300 * MS
SECOND = 1000 * MS
GUARD_REQUEST = Frame(0, 0x701, b"", REMOTE, "", 1)


@pytest.fixture
def watch():
    return Supervision((1, 2, 16), TIMEOUT)


def beat(node, t_ns, state=5):
    return Frame(t_ns, 0x700 + node, bytes((state,)))


def emcy(node, code, t_ns=0, register=1):
    return Frame(t_ns, 0x080 + node, struct.pack("<HB5s", code, register, b"maker"))


def heard(watch, *times_ms, state=5):
    """Heartbeats of node 1; returns the stamp of the last, ns."""
    for at in times_ms:
        watch.observe(beat(1, round(at * MS), state))
    return round(times_ms[-1] * MS)


def silence_until_lost(watch, since_ns):
    """Ms of silence after which node 1 is lost; -1: not within three minutes."""
    lost = (ms for ms in range(0, 180_000, 50) if any_lost(watch, since_ns + ms * MS + 1))
    ms = next(lost, -1)
    assert ms < 0 or watch.life(1, since_ns + ms * MS + 1) is Life.LOST
    return ms


def test_never_seen_is_not_supervised(watch):
    assert watch.states(10**15) == dict.fromkeys((1, 2, 16), NodeState(Life.NEVER_SEEN, -1, -1))


def test_alive_until_the_timeout_has_passed_and_again_after(watch):
    watch.observe(beat(2, 1000 - 100 * MS))
    watch.observe(beat(2, 1000))
    assert watch.life(2, 1000 + TIMEOUT) is Life.ALIVE
    assert watch.life(2, 1001 + TIMEOUT) is Life.LOST
    assert watch.states(2000)[2] == (Life.ALIVE, 5, 1000)
    assert watch.life(1, 2000) is Life.NEVER_SEEN
    watch.observe(beat(2, 10 * TIMEOUT, 127))
    assert watch.states(10 * TIMEOUT)[2] == (Life.ALIVE, 127, 0)


def test_an_older_heartbeat_does_not_turn_time_back(watch):
    watch.observe(beat(1, 500 * MS, 5))
    watch.observe(beat(1, 100 * MS, 4))
    assert watch.states(600 * MS)[1] == (Life.ALIVE, 5, 100 * MS)


def test_boot_up_is_a_sign_of_life_and_counted(watch):
    watch.observe(beat(1, 0, 0))
    watch.observe(beat(1, MS, 127))
    watch.observe(beat(1, 2 * MS, 0))
    assert watch.heartbeats["boots"].tolist() == [2, 0, 0]
    assert watch.states(2 * MS)[1].nmt_state == 0


def test_the_toggle_bit_of_node_guarding_is_left_out(watch):
    watch.observe(beat(1, 0, 0x85))
    assert watch.states(0)[1].nmt_state == 5


@pytest.mark.parametrize(
    ("period_ms", "silence_ms"),
    [(20, 300), (100, 300), (250, 750), (1000, 3000), (60_000, 180_000)],
)
def test_the_time_out_is_three_of_the_periods_that_are_heard(watch, period_ms, silence_ms):
    last = heard(watch, *range(0, 20 * period_ms, period_ms))
    assert not any_lost(watch, last + silence_ms * MS)
    assert watch.life(1, last + silence_ms * MS) is Life.ALIVE
    assert any_lost(watch, last + silence_ms * MS + 1)
    assert watch.life(1, last + silence_ms * MS + 1) is Life.LOST


def test_one_heartbeat_is_not_enough_and_the_second_is(watch):
    last = heard(watch, 0)
    assert silence_until_lost(watch, last) == -1
    last = heard(watch, 1000)
    assert silence_until_lost(watch, last) == 3000


@pytest.mark.parametrize(
    ("times_ms", "silence_ms"),
    [
        ((0, 1000, 2000, 4000, 5000), 3000),  # one lost
        ((0, 2000, 3000, 4000), 3000),  # the second one lost
        ((0, 100, 200, 60_200, 60_300), 300),  # a stop of a minute
        ((0, 90_000, 90_100), 300),  # longer than any heartbeat period
        ((0, 1000, 2000, 3000, 3500, 4000), 3000),  # one too many
        ((0, 0.2, 1000, 1000.2, 2000, 2000.2), 3000),  # repeated by the controller
        ((0, 1000, 2900, 3100, 4000), 3000),  # one late
        ((0, 100, 200, 300, 1300, 2300, 3300), 3000),  # another period was written
        ((0, 1000, 2000, 3000, 3100, 3200, 3300), 300),
    ],
)
def test_the_period_outlives_what_is_lost_late_or_repeated(watch, times_ms, silence_ms):
    assert silence_until_lost(watch, heard(watch, *times_ms)) == silence_ms


def test_a_configured_period_is_not_learnt():
    for period_ms, silence_ms in ((1000, 3000), (50, 300)):
        watch = Supervision((1,), TIMEOUT, period_ms * MS)
        last = heard(watch, 0)
        assert silence_until_lost(watch, last) == -1
        last = heard(watch, 100, 200, 300)
        assert silence_until_lost(watch, last) == silence_ms


def test_a_boot_up_is_no_heartbeat(watch):
    watch.observe(beat(1, 0, 0))
    watch.observe(beat(1, 100 * MS, 0))
    assert silence_until_lost(watch, 100 * MS) == -1
    last = heard(watch, 150, 250)
    assert silence_until_lost(watch, last) == 300
    for k in range(1, 10):
        watch.observe(beat(1, last + k * 100 * MS, 0))
    assert any_lost(watch, last + 301 * MS), "it boots again and again"


def test_a_change_of_state_is_told_at_once_and_says_nothing_of_the_period(watch):
    heard(watch, 0, state=127)
    assert silence_until_lost(watch, heard(watch, 120)) == -1
    assert silence_until_lost(watch, heard(watch, 1120)) == 3000


@pytest.mark.parametrize("requests", [True, False])
def test_a_node_that_answers_node_guarding_is_not_supervised(watch, requests):
    """Nor once the guarding ends, whether or not the requests were recorded, some answers lost."""
    for k in range(40):
        if requests:
            watch.observe(GUARD_REQUEST)
        if k % 7 != 5:
            watch.observe(beat(1, k * SECOND, 0x05 | (k % 2) << 7))
    assert watch.malformed == 0
    assert silence_until_lost(watch, 39 * SECOND) == -1
    last = heard(watch, *range(40_000, 40_500, 100))
    assert silence_until_lost(watch, last) == 300, "the master has turned to heartbeats"


def test_the_first_answers_to_node_guarding_are_no_heartbeats(watch):
    """Toggle bit 0 twice, because the one between was lost; then the guarding ends."""
    for at in (0, 2 * SECOND):
        watch.observe(GUARD_REQUEST)
        watch.observe(beat(1, at))
    assert silence_until_lost(watch, 2 * SECOND) == -1


def test_a_request_to_one_who_does_not_answer_ends_no_supervision(watch):
    last = heard(watch, 0, 100, 200)
    watch.observe(GUARD_REQUEST)
    assert silence_until_lost(watch, last) == 300
    last = heard(watch, 300, 400)
    assert silence_until_lost(watch, last) == 300


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, 0x701, b""), Frame(0, 0x701, b"\x05\x00"), Frame(0, 0x701, b"\x03"),
        Frame(0, 0x701, b"\x05", FD), Frame(0, 0x081, bytes(7)), Frame(0, 0x081, bytes(8), FD),
        Frame(0, 0x081, b"", REMOTE, "", 8),
    ],
)  # fmt: skip
def test_malformed_ones_are_counted_and_no_sign_of_life(watch, frame):
    assert watch.observe(frame)
    assert watch.malformed == 1
    assert watch.life(1, 0) is Life.NEVER_SEEN
    assert watch.emcy[1].received == 0


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, 0x080, b""), Frame(0, 0x703, b"\x05"), Frame(0, 0x720, b"\x05"),
        Frame(0, 0x181, bytes(8)), Frame(0, 0x701, b"\x05", EXTENDED),
        Frame(0, 0x081, bytes(8), ERROR), Frame(0, 0x701, bytes(8), ERROR),
    ],
)  # fmt: skip
def test_other_frames_are_left_alone(watch, frame):
    assert not watch.observe(frame)
    assert watch.malformed == 0
    assert watch.life(1, 0) is Life.NEVER_SEEN


def test_emergencies_are_kept_per_node_with_their_parts(watch):
    assert watch.observe(emcy(1, 0x4210, 7, 0x09))
    (entry,) = watch.emcy[1].recent
    assert entry == (7, 0x4210, 0x09, b"maker")
    assert watch.emcy[2].received == 0


def test_an_emergency_storm_costs_no_memory(watch):
    for k in range(20_000):
        watch.observe(emcy(1, 0x1000 + k % 5000))
    log = watch.emcy[1]
    assert log.received == 20_000
    assert len(log.recent) == 16
    assert log.recent[-1].code == 0x1000 + 19_999 % 5000
