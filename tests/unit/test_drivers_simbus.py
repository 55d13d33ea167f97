"""The simulated drives in real time: what leaves after a stall, and the ways to end."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from dbc.frame import FD, MS, Frame
from dbc.frames import Block, block_of
from gateway.hil import simbus
from gateway.hil.simbus import NEWEST, NEWEST_FD, newest, run_on_bus
from gateway.io.live import Stop
from gateway.io.transport import SendResult, Status


class Bus:
    """A transport that keeps what is sent and delivers one frame."""

    def __init__(self) -> None:
        self.status = Status()
        self.sent: list[Frame] = []
        self.waiting = [Frame(0, 0x1A0, b"\0")]
        self.closed = False

    def open(self) -> None:
        pass

    def receive(self, timeout_s: float) -> list[Frame]:
        assert timeout_s == 0.0
        frames, self.waiting = self.waiting, []
        return frames

    def receive_block(self, timeout_s: float) -> Block:
        return block_of(self.receive(timeout_s))

    def send(self, frame: Frame) -> SendResult:
        self.sent.append(frame)
        return SendResult.SENT

    def close(self) -> None:
        self.closed = True


class World:
    """One frame per millisecond of its time."""

    fastest_cycle_ns = 2 * MS

    def __init__(self) -> None:
        self.heard: list[Frame] = []
        self.times: list[int] = []

    def step(self, frames: Iterable[Frame], now_ns: int) -> list[Frame]:
        self.heard += frames
        done = self.times[-1] if self.times else -MS
        self.times.append(now_ns)
        return [Frame(t, 0x181, b"") for t in range(done // MS * MS + MS, now_ns + 1, MS)]


def test_of_every_id_the_newest_are_held() -> None:
    fast = [Frame(k, 0x181, bytes((k,))) for k in range(NEWEST + 3)]
    fd = [Frame(k, 0x182, bytes((k,)), FD) for k in range(NEWEST_FD + 1)]
    slow = [Frame(0, 0x1C1, b"late, but the only one")]
    assert newest([*slow, *fast, *fd]) == [*slow, *fast[3:], *fd[1:]]
    assert newest(fast[:NEWEST]) == fast[:NEWEST]
    assert newest([]) == []


def test_the_world_runs_to_its_end_in_real_time() -> None:
    bus, world = Bus(), World()
    lost = run_on_bus(world, bus, 0.02, lambda: None)  # type: ignore[arg-type]
    assert world.times[0] == 0
    assert world.times[-1] == 20 * MS
    assert world.times == sorted(world.times)
    assert len(bus.sent) + lost == 21
    assert world.heard == [Frame(0, 0x1A0, b"\0")]
    assert bus.closed


def test_a_stall_is_caught_up_but_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, world = Bus(), World()
    stamps = iter((0, 0, 100 * MS, 100 * MS))

    class Stalling(simbus.Ticker):
        def __init__(self, period_ns: int) -> None:
            super().__init__(period_ns, clock=lambda: next(stamps), sleep=lambda _: None)

    monkeypatch.setattr(simbus, "Ticker", Stalling)
    lost = run_on_bus(world, bus, 0.1, lambda: None)  # type: ignore[arg-type]
    assert world.times == [0, 100 * MS]
    assert [f.t_ns // MS for f in bus.sent] == [0, *range(101 - NEWEST, 101)]
    assert lost == 100 - NEWEST


def test_a_stop_ends_it_and_the_bus_is_given_back() -> None:
    bus, world, stop = Bus(), World(), Stop()
    run_on_bus(world, bus, 3600.0, stop, stop)  # type: ignore[arg-type]
    assert len(world.times) == 1
    assert bus.closed
