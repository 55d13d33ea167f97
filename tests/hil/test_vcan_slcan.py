"""Our SocketCAN transport on a link of type `can`: bus states, full queue, unplugging.

vcan has no error frames, no queue and no plug. An slcan link over a pseudo terminal has all
three: the test plays the serial CAN adapter at the other end.
"""

import socket
import subprocess
import time
from typing import NamedTuple

import pytest

from dbc.codec import bind
from dbc.e2e import WINDOW, Check, Receiver, SmState, protect
from dbc.frame import ERROR, SECOND, Frame
from gateway.hil.vcan.slcan import Adapter
from gateway.io import socketcan
from gateway.io.bus import open_transport
from gateway.io.links import Links
from gateway.io.socketcan import SocketCan
from gateway.io.transport import Allow, LinkState, SendResult
from gateway.io.wire import BusState
from gateway.settings.config import shipped_dbc
from tests.buses import frames_of

pytestmark = pytest.mark.vcan

PATIENCE_S = 60.0
CAN_RAW_ERR_FILTER = 2
DATA = Frame(0, 0x1A0, b"\x01\x02")


@pytest.fixture
def adapter():
    try:
        adapter = Adapter()
    except OSError as error:
        pytest.skip(f"no slcan here: {error}")
    subprocess.run(["ip", "link", "set", adapter.name, "up"], check=True)
    yield adapter
    adapter.unplug()


@pytest.fixture
def bus(adapter):
    bus = SocketCan(adapter.name)
    bus.open()
    yield bus
    bus.close()


def until(bus, fulfilled):
    frames = []
    deadline = time.monotonic() + PATIENCE_S
    while not fulfilled():
        assert time.monotonic() < deadline, f"not within {PATIENCE_S} s: {bus.status}"
        time.sleep(0.01)
        frames += frames_of(bus)
    return frames


def frames_on(adapter):
    """The frames among the commands, some of which open the channel, at any time."""
    return [command for command in adapter.commands() if command.startswith("t")]


def test_frames_go_both_ways(bus, adapter):
    adapter.says("t18121122")
    (frame,) = until(bus, lambda: bus.status.received == 1)
    assert frame._replace(t_ns=0) == Frame(0, 0x181, b"\x11\x22", 0, adapter.name)
    assert bus.send(DATA) is SendResult.SENT
    heard = []
    until(bus, lambda: bool(heard.extend(frames_on(adapter)) or heard))
    assert heard == ["t1A020102"]


def test_bus_states_are_told_by_error_frames(bus, adapter):
    for text, state in (
        ("sw000100", BusState.WARNING),
        ("sp000130", BusState.PASSIVE),
        ("sa000000", BusState.ACTIVE),
    ):
        adapter.says(text)
        frames = until(bus, lambda wanted=state: bus.status.bus_state is wanted)
        assert all(frame.flags == ERROR for frame in frames)


def test_in_bus_off_nothing_is_queued_that_would_leave_stale(bus, adapter):
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
    assert bus.send(Frame(0, 0x1A0, b"new")) is SendResult.SENT
    heard = []
    until(bus, lambda: bool(heard.extend(adapter.commands()) or "t1A036E6577" in heard))
    assert "t1A020102" not in heard


def test_a_full_queue_is_counted_and_does_not_block(bus):
    results = [bus.send(DATA) for _ in range(3000)]  # nobody reads the line
    assert results[0] is SendResult.SENT
    assert results[-1] is SendResult.FULL
    assert bus.status.tx_full == results.count(SendResult.FULL)
    assert bus.status.sent + bus.status.tx_full == 3000
    assert bus.status.state is LinkState.UP


def test_unplugging_is_survived_and_the_next_adapter_is_used(bus, adapter):
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


class Arrival(NamedTuple):
    """A frame as it came down the line."""

    data: bytes
    age: int
    """Ticks since it was handed over."""


FLAGS = 0x1A0
T_S = 0.01
BEGIN, STALL, TICKS = 30, 120, 300
"""In ticks, by which all is measured here: a machine that stands still makes no frame old."""
LATE = STALL // 2


def stalled(bus, adapter):
    """Flag frames that come where nobody reads the line for 120 ticks of a loop at 100 Hz.

    Every tick sends a flag frame, protected as ours are, that says which.
    """
    spec = bind(shipped_dbc("traction.dbc"), (1, 2, 3)).by_id[FLAGS]
    arrived = list[Arrival]()

    def read():
        for line in adapter.commands():
            if line.startswith("t1A08"):
                data = bytes.fromhex(line[5:])
                arrived.append(Arrival(data, tick - int.from_bytes(data[2:], "little")))

    for tick in range(TICKS):
        bus.receive()
        said = bytearray(bytes(2) + tick.to_bytes(6, "little"))
        protect(spec, said, tick)
        bus.send(Frame(0, FLAGS, bytes(said)))
        end = time.monotonic() + T_S
        while time.monotonic() < end:
            if not BEGIN <= tick < BEGIN + STALL:
                read()
            time.sleep(T_S / 10)
    return arrived


def believed_late(arrived):
    """Whether a receiver of the standard takes a late flag for valid."""
    receiver = Receiver(bind(shipped_dbc("traction.dbc"), (1, 2, 3)).by_id[FLAGS])
    states = []
    silent = True
    for arrival in arrived:
        late = arrival.age > LATE
        if late and silent:  # its cycles have passed meanwhile, with nothing
            for _ in range(WINDOW):
                receiver.cycle(Check.NO_NEW_DATA)
            silent = False
        states.append((late, receiver.cycle(receiver.check(arrival.data))))
    assert states[0][1] is not SmState.VALID
    assert states[-1] == (False, SmState.VALID)
    return (True, SmState.VALID) in states


@pytest.mark.parametrize("newest", [False, True])
def test_after_a_stall_next_to_nothing_leaves_late_and_nothing_of_it_is_believed(adapter, newest):
    """Two frames are out of reach: one in the controller, and the one that waits for it.

    Without `newest` the kernel's whole queue leaves, enough for a receiver to trust it.
    """
    bus = SocketCan(adapter.name, newest=newest)
    bus.open()
    arrived = stalled(bus, adapter)
    bus.close()
    late = [arrival.age for arrival in arrived if arrival.age > LATE]
    print(f"newest={newest}: {len(late)} of {len(arrived)} flag frames late, {bus.status.tx_full} "
          f"refused; ages {late} ticks")  # fmt: skip
    assert bus.status.tx_full > 50  # it did stand still
    if newest:
        assert len(late) <= 2
    else:
        assert len(late) > 5
    assert believed_late(arrived) is not newest


def test_our_frames_go_before_those_of_other_programs(adapter):
    other, ours = SocketCan(adapter.name), SocketCan(adapter.name, newest=True)
    other.open()
    ours.open()
    for k in range(8):  # nobody reads
        assert other.send(Frame(0, 0x600 + k, b"")) is SendResult.SENT
    assert ours.send(DATA) is SendResult.SENT
    heard = []
    until(ours, lambda: bool(heard.extend(frames_on(adapter)) or len(heard) == 9))
    assert heard.index("t1A020102") <= 2  # one has left the kernel, one is on its way out
    other.close()
    ours.close()


@pytest.fixture
def watched(adapter):
    """A transport with netlink, on a socket that gets no error frames."""
    bus = SocketCan(adapter.name, links=Links(adapter.name))
    bus.open()
    assert isinstance(bus._raw, socket.socket)
    bus._raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0)
    yield bus
    bus.close()


def test_bus_states_are_told_by_netlink_where_error_frames_are_not(watched, adapter):
    for text, state in (
        ("sw000100", BusState.WARNING),
        ("sp000130", BusState.PASSIVE),
        ("sa000000", BusState.ACTIVE),
        ("sb000255", BusState.BUS_OFF),
    ):
        adapter.says(text)
        until(watched, lambda wanted=state: watched.status.bus_state is wanted)
    assert (watched.status.error_frames, watched.status.bus_offs) == (0, 1)
    assert watched.send(DATA) is SendResult.DOWN


def until_state(asker, state):
    """Wait until the kernel itself gives this state."""
    deadline = time.monotonic() + PATIENCE_S
    while (found := asker.news()[1]) is None or found.state is not state:
        assert time.monotonic() < deadline, f"not within {PATIENCE_S} s: {found}"
        asker.hurry()
        time.sleep(0.01)
    asker.close()


def test_a_controller_that_is_off_already_is_seen_at_start(adapter):
    asker = Links(adapter.name)
    assert asker.start()
    adapter.says("sb000255")
    until_state(asker, BusState.BUS_OFF)
    bus = SocketCan(adapter.name, links=Links(adapter.name))
    bus.open()
    assert bus.status.bus_state is BusState.BUS_OFF
    assert bus.send(DATA) is SendResult.DOWN
    bus.close()


def test_a_link_that_will_stay_off_is_said_at_start_with_the_cure(adapter, caplog):
    subprocess.run(["ip", "link", "set", adapter.name, "txqueuelen", "500"], check=True)
    bus = open_transport({"interface": "socketcan", "channel": adapter.name}, Allow({}))
    said = [record.getMessage() for record in caplog.records]
    assert [line.split(":")[1].split()[0] for line in said] == ["restart-ms", "500"]
    assert f"ip link set {adapter.name} type can restart-ms 100" in said[0]
    assert f"ip link set {adapter.name} txqueuelen 10" in said[1]
    bus.close()


def test_who_is_off_again_and_again_stays_silent_until_it_is_past(adapter, monkeypatch):
    monkeypatch.setattr(socketcan, "BUS_OFF_WINDOW_NS", 3600 * SECOND)
    bus = SocketCan(adapter.name, links=Links(adapter.name))
    bus.open()
    for offs in range(1, 5):
        assert bus.send(DATA) is SendResult.SENT
        adapter.says("sb000255")
        until(bus, lambda: bus.status.bus_state is BusState.BUS_OFF)
        assert bus.status.bus_offs == offs
        adapter.says("sa000000")
        until(bus, lambda: bus.status.bus_state is BusState.ACTIVE)
        adapter.commands()
    assert bus.send(DATA) is SendResult.DOWN
    assert "4 bus-offs in a minute" in bus.status.note
    monkeypatch.setattr(socketcan, "BUS_OFF_WINDOW_NS", SECOND)
    until(bus, lambda: bus.send(DATA) is SendResult.SENT)
    bus.close()
