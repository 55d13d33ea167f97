"""Our SocketCAN transport on a real interface: frames, stamps, faults of the link, losses."""

import socket
import time

import pytest

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, SECOND, Frame
from gateway.io import interface_settings as settings
from gateway.io import kernel
from gateway.io.bus import open_transport
from gateway.io.socketcan import SocketCan
from gateway.io.transport import LinkState, SendResult
from gateway.io.wire import BusState
from tests.buses import frames_of

pytestmark = pytest.mark.vcan

PATIENCE_S = 60.0
PAUSE_NS = 20 * MS
KINDS = [
    Frame(0, 0x181, b"\x01\x02\x03", 0, "vcan0"),
    Frame(0, 0x181, b"", 0, "vcan0"),
    Frame(0, 0x1ABCDEF0, bytes(8), EXTENDED, "vcan0"),
    Frame(0, 0x181, bytes(8), 0, "vcan0", 12),
    Frame(0, 0x181, b"", REMOTE, "vcan0", 4),
    Frame(0, 0x181, bytes(range(64)), FD | BRS, "vcan0"),
    Frame(0, 0x181, bytes(12), FD, "vcan0"),
]


def until(bus, fulfilled):
    """Receive until the frames so far, or the state, are as wanted."""
    frames = []
    deadline = time.monotonic() + PATIENCE_S
    while not fulfilled(frames):
        assert time.monotonic() < deadline, f"not within {PATIENCE_S} s: {frames}, {bus.status}"
        frames += frames_of(bus)
        time.sleep(0.01)
    return frames


@pytest.fixture
def pair(vcan):
    """Two transports on the first interface."""
    a, b = SocketCan(vcan.name, fd=True), SocketCan(vcan.name, fd=True)
    a.open()
    b.open()
    yield a, b
    a.close()
    b.close()


def test_check_sees_the_link_as_the_kernel_has_it(vcan):
    (found,) = settings.link(vcan.name)
    assert found.found.startswith("vcan, up, queue ")
    assert not found.cure
    (absent,) = settings.link("nosuchcan0")
    assert absent.found == "not there"
    assert "ip link add nosuchcan0 type vcan" in absent.cure


def test_every_kind_of_frame_arrives_as_sent(pair):
    a, b = pair
    for frame in KINDS:
        assert a.send(frame) is SendResult.SENT
    received = until(b, lambda frames: len(frames) >= len(KINDS))
    assert [f._replace(t_ns=0) for f in received] == KINDS
    assert frames_of(a) == []  # own frames do not come back
    assert a.status.sent == b.status.received == len(KINDS)


def test_candump_sees_what_we_mean(vcan, pair, tmp_path):
    a, _ = pair
    dump = vcan.record(tmp_path / "log", count=3)
    for frame in (KINDS[0], KINDS[4], Frame(0, 0x502, bytes(12), FD | BRS)):
        a.send(frame)
    assert dump.wait(timeout=PATIENCE_S) == 0
    lines = (tmp_path / "log").read_text(encoding="ascii").splitlines()
    texts = [line.split(" ", 2)[2] for line in lines]
    # Kernels since 6.1 mark CAN FD frames with CANFD_FDF (4) themselves.
    texts[2] = texts[2].replace("##5", "##1")
    assert texts == ["181#010203", "181#R4", "502##1" + "00" * 12]


def test_cansend_frames_are_read_as_meant(vcan, pair):
    _, b = pair
    vcan.send("123#DEADBEEF", "00000123#R5", "123##311", "20000040#0000000000000000")
    received = until(b, lambda frames: len(frames) >= 4)
    assert [f._replace(t_ns=0) for f in received] == [
        Frame(0, 0x123, b"\xde\xad\xbe\xef", 0, "vcan0"),
        Frame(0, 0x123, b"", EXTENDED | REMOTE, "vcan0", 5),
        Frame(0, 0x123, b"\x11", FD | BRS | ESI, "vcan0"),
        Frame(0, 0x040, bytes(8), ERROR, "vcan0"),
    ]
    assert [f.is_plain_data for f in received] == [True, False, True, False]
    assert b.status.bus_state is BusState.BUS_OFF
    assert b.status.error_frames == 1


def test_stamps_are_the_time_of_reception_by_the_kernel(pair):
    """Two clocks are read one after the other: as long as that takes a frame may seem older."""
    a, b = pair
    slack, deadline = MS, time.monotonic() + PATIENCE_S
    reading_ns = PAUSE_NS
    while reading_ns >= PAUSE_NS:  # else all may seem as old as the first
        assert time.monotonic() < deadline, "this machine cannot read five frames at once"
        b.receive()
        windows = []
        for k in range(5):
            before = time.monotonic_ns()
            a.send(Frame(0, 0x181 + k, b""))
            windows.append((before, time.monotonic_ns()))
            time.sleep(PAUSE_NS / SECOND)
        begun = time.monotonic_ns()
        frames = frames_of(b)  # read long after arrival, all at once
        reading_ns = time.monotonic_ns() - begun
        assert len(frames) == 5
        for frame, (before, after) in zip(frames, windows, strict=True):
            assert before - slack - reading_ns <= frame.t_ns <= after + slack


@pytest.mark.usefixtures("own_clock")
def test_a_step_of_the_wall_clock_does_not_reach_the_stamps(pair):
    a, b = pair
    started = time.monotonic_ns()
    b.receive()
    real = time.time()
    try:
        a.send(KINDS[0])
        time.clock_settime(time.CLOCK_REALTIME, real + 3600)
        (first,) = until(b, bool)
        a.send(KINDS[0])
        time.clock_settime(time.CLOCK_REALTIME, real - 3600)
        (second,) = until(b, bool)
    finally:
        passed = (time.monotonic_ns() - started) / SECOND
        time.clock_settime(time.CLOCK_REALTIME, real + passed)
    assert started <= first.t_ns <= second.t_ns <= time.monotonic_ns()


def test_a_classic_socket_never_sees_fd_frames(vcan):
    classic, fd = SocketCan(vcan.name), SocketCan(vcan.name, fd=True)
    classic.open()
    fd.open()
    vcan.send("181##1AABB", "182#01")
    assert len(until(fd, lambda frames: len(frames) >= 2)) == 2
    assert [f.can_id for f in until(classic, bool)] == [0x182]
    assert classic.send(KINDS[5]) is SendResult.FAILED
    classic.close()
    fd.close()


def test_fd_on_a_classic_interface_is_refused_counted_and_explained(vcan):
    vcan.link("delete")
    vcan.link("create", mtu=16)
    bus = SocketCan(vcan.name, fd=True)
    bus.open()
    assert f"ip link set {vcan.name} mtu 72" in bus.status.note
    assert bus.send(KINDS[5]) is SendResult.FAILED
    assert bus.status.tx_failed == 1
    assert bus.send(KINDS[0]) is SendResult.SENT
    bus.close()


def test_link_down_and_up_again_is_survived(vcan, pair):
    a, b = pair
    for _ in range(3):
        vcan.link("down")
        until(b, lambda _: b.status.state is LinkState.DOWN)
        assert a.send(KINDS[0]) is SendResult.DOWN
        vcan.link("up")
        until(b, lambda _: b.status.state is LinkState.UP)
        until(a, lambda _: a.status.state is LinkState.UP)
        assert a.send(KINDS[0]) is SendResult.SENT
        assert len(until(b, bool)) == 1
    assert b.status.reopened == 0


def test_an_interface_absent_at_start_is_waited_for(vcan):
    vcan.link("delete")
    bus = open_transport({"interface": "socketcan", "channel": vcan.name})
    assert isinstance(bus, SocketCan)
    assert bus.status.state is LinkState.ABSENT
    assert frames_of(bus) == []
    assert bus.send(KINDS[0]) is SendResult.DOWN
    vcan.link("create")
    until(bus, lambda _: bus.status.state is LinkState.UP)
    vcan.send("181#01")
    assert len(until(bus, bool)) == 1
    assert bus.status.reopened == 0
    bus.close()


@pytest.mark.parametrize("reading", [True, False])
def test_a_deleted_and_recreated_interface_is_heard_again(vcan, pair, reading):
    _, b = pair
    for round_number in range(1, 4):
        vcan.link("delete")
        if reading:  # else it is gone and back between two reads
            until(b, lambda _: b.status.state is LinkState.ABSENT)
            assert b.send(KINDS[0]) is SendResult.DOWN
        vcan.link("create")
        until(b, lambda _, n=round_number: b.status.reopened == n)
        assert b.status.state is LinkState.UP
        vcan.send("181#01")
        assert len(until(b, bool)) == 1
        assert b.send(KINDS[0]) is SendResult.SENT


def test_lost_frames_are_counted_exactly(vcan, monkeypatch):
    monkeypatch.setattr(kernel, "RECEIVE_BUFFER", 64 << 10)
    bus = SocketCan(vcan.name)
    bus.open()
    sender = SocketCan(vcan.name)
    sender.open()
    sent = 1000
    for k in range(sent):
        assert sender.send(Frame(0, k & 0x7FF, bytes(8))) is SendResult.SENT
    bus.receive()
    deadline = time.monotonic() + PATIENCE_S
    while bus.status.received + bus.status.kernel_drops != sent:
        assert time.monotonic() < deadline, f"{sent} were sent: {bus.status}"
        sender.send(KINDS[0])  # the count comes with the next frame that fits
        sent += 1
        bus.receive()
    assert bus.status.kernel_drops > 0
    bus.close()
    sender.close()


def test_the_receive_buffer_holds_a_second_of_a_full_bus(vcan):
    bus = SocketCan(vcan.name)
    bus.open()
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((vcan.name,))
    other = SocketCan(vcan.name)
    other.open()
    for _ in range(74):  # 8-byte frames at 1 Mbit/s
        for _ in range(100):
            raw.send(b"\x81\x01\x00\x00\x08\x00\x00\x00" + bytes(8))
        until(other, lambda frames: len(frames) >= 100)  # so the kernel has handed them out
    until(bus, lambda frames: len(frames) >= 7400)
    assert (bus.status.received, bus.status.kernel_drops) == (7400, 0)
    for each in (raw, other, bus):
        each.close()
