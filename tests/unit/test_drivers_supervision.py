"""Heartbeat supervision and the emergency log."""

from __future__ import annotations

import struct

import pytest

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, Frame
from gateway.supervision import Life, NodeState, Supervision

TIMEOUT = 300 * MS


@pytest.fixture
def watch() -> Supervision:
    return Supervision((1, 2, 16), TIMEOUT)


def beat(node: int, t_ns: int, state: int = 5) -> Frame:
    return Frame(t_ns, 0x700 + node, bytes((state,)))


def emcy(node: int, code: int, t_ns: int = 0, register: int = 1) -> Frame:
    return Frame(t_ns, 0x080 + node, struct.pack("<HB5s", code, register, b"maker"))


def test_never_seen_is_not_supervised(watch: Supervision) -> None:
    assert watch.states(10**15) == dict.fromkeys((1, 2, 16), NodeState(Life.NEVER_SEEN, -1, -1))


def test_alive_until_the_timeout_has_passed_and_again_after(watch: Supervision) -> None:
    watch.observe(beat(2, 1000))
    assert watch.life(2, 1000 + TIMEOUT) is Life.ALIVE
    assert watch.life(2, 1001 + TIMEOUT) is Life.LOST
    assert watch.states(2000)[2] == (Life.ALIVE, 5, 1000)
    assert watch.life(1, 2000) is Life.NEVER_SEEN
    watch.observe(beat(2, 10 * TIMEOUT, 127))
    assert watch.states(10 * TIMEOUT)[2] == (Life.ALIVE, 127, 0)


def test_an_older_heartbeat_does_not_turn_time_back(watch: Supervision) -> None:
    watch.observe(beat(1, 500 * MS, 5))
    watch.observe(beat(1, 100 * MS, 4))
    assert watch.states(600 * MS)[1] == (Life.ALIVE, 5, 100 * MS)


def test_boot_up_is_a_sign_of_life_and_counted(watch: Supervision) -> None:
    watch.observe(beat(1, 0, 0))
    watch.observe(beat(1, MS, 127))
    watch.observe(beat(1, 2 * MS, 0))
    assert watch.boots == {1: 2, 2: 0, 16: 0}
    assert watch.states(2 * MS)[1].nmt_state == 0


def test_the_toggle_bit_of_node_guarding_is_left_out(watch: Supervision) -> None:
    watch.observe(beat(1, 0, 0x85))
    assert watch.states(0)[1].nmt_state == 5


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, 0x701, b""),
        Frame(0, 0x701, b"\x05\x00"),
        Frame(0, 0x701, b"\x03"),
        Frame(0, 0x701, b"\x05", FD),
        Frame(0, 0x701, b"", REMOTE, "", 1),
        Frame(0, 0x081, bytes(7)),
        Frame(0, 0x081, bytes(8), FD),
        Frame(0, 0x081, b"", REMOTE, "", 8),
    ],
)
def test_malformed_ones_are_counted_and_no_sign_of_life(watch: Supervision, frame: Frame) -> None:
    assert watch.observe(frame)
    assert watch.malformed == 1
    assert watch.life(1, 0) is Life.NEVER_SEEN
    assert watch.emcy[1].received == 0


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, 0x080, b""),
        Frame(0, 0x703, b"\x05"),
        Frame(0, 0x720, b"\x05"),
        Frame(0, 0x181, bytes(8)),
        Frame(0, 0x701, b"\x05", EXTENDED),
        Frame(0, 0x081, bytes(8), ERROR),
        Frame(0, 0x701, bytes(8), ERROR),
    ],
)
def test_other_frames_are_left_alone(watch: Supervision, frame: Frame) -> None:
    assert not watch.observe(frame)
    assert watch.malformed == 0
    assert watch.life(1, 0) is Life.NEVER_SEEN


def test_emergencies_are_kept_per_node_with_their_parts(watch: Supervision) -> None:
    assert watch.observe(emcy(1, 0x4210, 7, 0x09))
    (entry,) = watch.emcy[1].recent
    assert entry == (7, 0x4210, 0x09, b"maker")
    assert watch.emcy[1].active == (0x4210,)
    assert watch.emcy[2].received == 0


def test_a_reset_clears_the_active_errors(watch: Supervision) -> None:
    for code in (0x4210, 0x2310, 0x4210):
        watch.observe(emcy(2, code))
    assert watch.emcy[2].active == (0x4210, 0x2310)
    watch.observe(emcy(2, 0x0000, register=0))
    assert watch.emcy[2].active == ()
    assert watch.emcy[2].received == 4


def test_an_emergency_storm_costs_no_memory(watch: Supervision) -> None:
    for k in range(20_000):
        watch.observe(emcy(1, 0x1000 + k % 5000))
    log = watch.emcy[1]
    assert log.received == 20_000
    assert len(log.recent) == 16
    assert log.recent[-1].code == 0x1000 + 19_999 % 5000
    assert len(log.active) == 16
    assert log.unlisted == 20_000 - 4 * 16
