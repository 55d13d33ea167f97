"""Our SocketCAN transport on a link of type `can`: bus states, full queue, unplugging.

vcan has no error frames, no queue and no plug. An slcan link over a pseudo terminal has all
three: the test plays the serial CAN adapter at the other end.
"""

from __future__ import annotations

import fcntl
import os
import pty
import socket
import struct
import subprocess
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from dbc.frame import ERROR, Frame
from gateway.drivers.socketcan import SocketCan
from gateway.drivers.transport import LinkState, SendResult
from gateway.drivers.wire import BusState

pytestmark = pytest.mark.vcan

PATIENCE_S = 20.0
TIOCSETD, N_SLCAN = 0x5423, 17
DATA = Frame(0, 0x1A0, b"\x01\x02")


class Adapter:
    """The far end of an slcan link."""

    def __init__(self) -> None:
        before = set(interfaces())
        self.master, self._line = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._line)
        fcntl.ioctl(self._line, TIOCSETD, struct.pack("i", N_SLCAN))
        new = set(interfaces()) - before
        if not new:
            msg = "slcan links appear outside of this network namespace"
            raise OSError(msg)
        (self.name,) = new
        os.set_blocking(self.master, False)

    def says(self, text: str) -> None:
        os.write(self.master, text.encode() + b"\r")

    def heard(self) -> list[str]:
        """Complete commands that came down the line, such as `t1A020102`."""
        try:
            return os.read(self.master, 65536).decode().split("\r")[:-1]
        except BlockingIOError:
            return []

    def unplug(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            os.close(self._line)
            self.master = -1


def interfaces() -> list[str]:
    return [name for _, name in socket.if_nameindex()]


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    try:
        adapter = Adapter()
    except OSError as error:
        pytest.skip(f"no slcan here: {error}")
    subprocess.run(["ip", "link", "set", adapter.name, "up"], check=True)
    yield adapter
    adapter.unplug()


@pytest.fixture
def bus(adapter: Adapter) -> Iterator[SocketCan]:
    bus = SocketCan(adapter.name)
    bus.open()
    adapter.heard()  # the commands that open the channel
    yield bus
    bus.close()


def until(bus: SocketCan, fulfilled: Callable[[], bool]) -> list[Frame]:
    frames: list[Frame] = []
    deadline = time.monotonic() + PATIENCE_S
    while not fulfilled():
        assert time.monotonic() < deadline, f"not within {PATIENCE_S} s: {bus.status}"
        frames += bus.receive(0.02)
    return frames


def test_frames_go_both_ways(bus: SocketCan, adapter: Adapter) -> None:
    adapter.says("t18121122")
    (frame,) = until(bus, lambda: bus.status.received == 1)
    assert frame._replace(t_ns=0) == Frame(0, 0x181, b"\x11\x22", 0, adapter.name)
    assert bus.send(DATA) is SendResult.SENT
    heard: list[str] = []
    until(bus, lambda: bool(heard.extend(adapter.heard()) or heard))
    assert heard == ["t1A020102"]


def test_bus_states_are_told_by_error_frames(bus: SocketCan, adapter: Adapter) -> None:
    for text, state in (
        ("sw000100", BusState.WARNING),
        ("sp000130", BusState.PASSIVE),
        ("sa000000", BusState.ACTIVE),
    ):
        adapter.says(text)
        frames = until(bus, lambda wanted=state: bus.status.bus_state is wanted)
        assert all(frame.flags == ERROR for frame in frames)


def test_in_bus_off_nothing_is_queued_that_would_leave_stale(
    bus: SocketCan, adapter: Adapter
) -> None:
    adapter.says("sb000255")
    until(bus, lambda: bus.status.bus_state is BusState.BUS_OFF)
    assert {bus.send(DATA) for _ in range(50)} == {SendResult.DOWN}
    assert (bus.status.tx_down, bus.status.sent) == (50, 0)
    subprocess.run(["ip", "link", "set", adapter.name, "down"], check=True)
    until(bus, lambda: bus.status.state is LinkState.DOWN)
    subprocess.run(["ip", "link", "set", adapter.name, "up"], check=True)
    until(bus, lambda: bus.status.state is LinkState.UP)
    assert bus.status.bus_state is BusState.ACTIVE
    adapter.says("sa000000")
    adapter.heard()
    assert bus.send(Frame(0, 0x1A0, b"new")) is SendResult.SENT
    heard: list[str] = []
    until(bus, lambda: bool(heard.extend(adapter.heard()) or "t1A036E6577" in heard))
    assert "t1A020102" not in heard


def test_a_full_queue_is_counted_and_does_not_block(bus: SocketCan) -> None:
    results = [bus.send(DATA) for _ in range(3000)]  # nobody reads the line
    assert results[0] is SendResult.SENT
    assert results[-1] is SendResult.FULL
    assert bus.status.tx_full == results.count(SendResult.FULL)
    assert bus.status.sent + bus.status.tx_full == 3000
    assert bus.status.state is LinkState.UP


def test_unplugging_is_survived_and_the_next_adapter_is_used(
    bus: SocketCan, adapter: Adapter
) -> None:
    adapter.unplug()
    until(bus, lambda: bus.status.state is LinkState.ABSENT)
    assert bus.send(DATA) is SendResult.DOWN
    again = Adapter()
    try:
        assert again.name == adapter.name
        subprocess.run(["ip", "link", "set", again.name, "up"], check=True)
        until(bus, lambda: bus.status.state is LinkState.UP)
        assert bus.status.reopened == 1
        again.says("t1811AA")
        until(bus, lambda: bus.status.received == 1)
    finally:
        again.unplug()
