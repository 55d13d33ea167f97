"""The SocketCAN transport against a stand-in for the kernel: faults in any order, no bus."""

import errno
import os
import socket
import struct
from collections import deque
from unittest.mock import Mock

import pytest

from dbc.frame import ERROR, FD, MS, SECOND, Frame
from gateway.io.kernel import Kernel, Link
from gateway.io.links import Facts, Links
from gateway.io.socketcan import BATCH, SocketCan
from gateway.io.transport import LinkState, SendResult
from gateway.io.wire import BusState, pack
from gateway.settings.config import ConfigError
from tests.buses import frames_of
from tests.messages import put

HOUR = 3600 * SECOND
DATA = Frame(0, 0x181, b"\x01\x02")


def problem(code):
    return OSError(code, os.strerror(code))


class FakeSocket:
    """Queue of frames and errors to read; errors to raise when sending."""

    def __init__(self):
        self.to_read = deque()
        self.send_errors = deque()
        self.sent = []
        self.closed = False

    def fileno(self):
        return 99

    def fill(self, batch):
        """As `recvmmsg`: what waits before the next error, the error if nothing does."""
        assert not self.closed
        if not self.to_read:
            raise BlockingIOError(errno.EAGAIN, "nothing")
        if isinstance(self.to_read[0], OSError):
            raise self.to_read.popleft()
        while self.to_read and not batch.full and not isinstance(self.to_read[0], OSError):
            put(batch, *self.to_read.popleft())

    def send(self, data):
        if self.send_errors:
            raise self.send_errors.popleft()
        self.sent.append(data)
        return len(data)

    def close(self):
        self.closed = True


class FakeKernel(Kernel):
    """Clocks, one interface and the sockets bound to it."""

    def __init__(self):
        self.mono = 50 * SECOND
        self.real = 1_790_000_000 * SECOND
        self.link = Link(7, up=True, mtu=72)
        self.sockets = []
        self.refuse = None
        self.waiting = 0
        self.reads = 0

    def monotonic_ns(self):
        return self.mono

    def real_ns(self):
        return self.real

    def connect(self, channel, fd, first=False):
        if self.refuse is not None:
            raise self.refuse
        if self.link is None:
            raise problem(errno.ENODEV)
        self.sockets.append(FakeSocket())
        return self.sockets[-1]

    def queued(self, raw):
        return self.waiting

    def look(self, raw, channel):
        return self.link

    def read(self, raw, batch):
        assert isinstance(raw, FakeSocket)
        self.reads += 1
        raw.fill(batch)
        if raw.to_read and isinstance(raw.to_read[0], OSError):
            raise raw.to_read.popleft()
        return not raw.to_read

    def pass_time(self, ns):
        self.mono += ns
        self.real += ns

    def arrive(self, frame=DATA, drops=None):
        """Queue a frame with the kernel's control messages, as of now."""
        control = [(socket.SOL_SOCKET, 35, struct.pack("@ll", *divmod(self.real, SECOND)))]
        if drops is not None:
            control.append((socket.SOL_SOCKET, 40, struct.pack("=I", drops)))
        payload = pack(frame)
        assert payload is not None
        self.sockets[-1].to_read.append((payload, control))


OFF = Frame(0, 0x040, bytes(8), ERROR)
RESTARTED = Frame(0, 0x100, bytes(8), ERROR)


def error(kernel, frame):
    """`pack` does not make error frames: nobody sends them."""
    word = struct.pack("=IB3x", frame.can_id | 0x2000_0000, 8) + frame.data
    kernel.sockets[-1].to_read.append((word, []))


@pytest.fixture
def kernel():
    return FakeKernel()


@pytest.fixture
def bus(kernel):
    bus = SocketCan("vcan0", kernel=kernel)
    bus.open()
    return bus


def test_a_batch_is_read_at_once_with_reception_times(kernel, bus):
    arrivals = []
    for k in range(5):
        kernel.pass_time(MS)
        kernel.arrive(Frame(0, 0x181 + k, b"x"))
        arrivals.append(kernel.mono)
    kernel.pass_time(3 * MS)
    frames = frames_of(bus)
    assert [f.t_ns for f in frames] == arrivals
    assert [f.can_id for f in frames] == [0x181, 0x182, 0x183, 0x184, 0x185]
    assert {f.channel for f in frames} == {"vcan0"}
    assert bus.status.received == 5
    assert kernel.reads == 1
    assert frames_of(bus) == []


def test_a_down_between_two_frames_of_one_read_is_told_and_costs_none(kernel, bus):
    kernel.arrive()
    kernel.sockets[-1].to_read.append(problem(errno.ENETDOWN))
    kernel.pass_time(MS)
    arrived = kernel.mono
    kernel.arrive()
    kernel.pass_time(3 * MS)
    assert [f.t_ns for f in frames_of(bus)] == [arrived - MS, arrived]
    assert bus.status.state is LinkState.DOWN


def test_an_error_that_the_kernel_keeps_after_a_read_is_raised():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw,
    ):
        nobody.bind(("127.0.0.1", 0))
        raw.setblocking(False)
        raw.connect(nobody.getsockname())
        nobody.close()
        batch = Mock(read_from=Mock(return_value=True))  # as if it came up in the middle of one
        assert Kernel().read(raw, batch)
        raw.send(b"refused")
        with pytest.raises(ConnectionRefusedError):
            Kernel().read(raw, batch)
        assert Kernel().read(raw, batch)
        assert not Kernel().read(raw, Mock(read_from=Mock(return_value=False)))


@pytest.mark.parametrize("step", [-HOUR, HOUR])
def test_a_step_of_the_wall_clock_moves_a_stamp_by_one_read_at_most(kernel, bus, step):
    kernel.pass_time(10 * MS)
    assert frames_of(bus) == []
    emptied = kernel.mono
    kernel.pass_time(4 * MS)
    kernel.arrive()
    kernel.real += step
    kernel.pass_time(6 * MS)
    (frame,) = frames_of(bus)
    assert emptied <= frame.t_ns <= kernel.mono
    kernel.pass_time(5 * MS)
    kernel.arrive()
    kernel.pass_time(5 * MS)
    (later,) = frames_of(bus)
    assert later.t_ns == kernel.mono - 5 * MS


@pytest.mark.parametrize("call", ["monotonic_ns", "real_ns", "read"])
def test_a_process_that_stands_still_while_it_reads_takes_no_frame_for_newer(
    kernel, bus, monkeypatch, call
):
    """Nor the one that comes meanwhile, which only the next call reads."""
    arrivals = []

    def arrive():
        kernel.pass_time(50 * MS)
        kernel.arrive()
        arrivals.append(kernel.mono)
        kernel.pass_time(100 * MS)

    def stands(self, *given):
        answer = original(self, *given)
        if len(arrivals) < 3:
            arrive()
        return answer

    original = getattr(FakeKernel, call)
    arrive()
    monkeypatch.setattr(FakeKernel, call, stands)
    stamps = [f.t_ns for _ in range(4) for f in frames_of(bus)]
    assert len(stamps) == len(arrivals) == 3
    assert all(stamp <= arrived for stamp, arrived in zip(stamps, arrivals, strict=True))


def test_a_flood_is_read_in_bounded_batches_and_ages_stay_right(kernel, bus):
    arrived = kernel.mono
    for _ in range(BATCH + 3):
        kernel.arrive()
    kernel.pass_time(2 * SECOND)
    assert len(frames_of(bus)) == BATCH
    kernel.pass_time(SECOND)
    rest = frames_of(bus)
    assert [f.t_ns for f in rest] == [arrived] * 3


def test_drops_are_counted_across_wrap_and_reopening(kernel, bus):
    for drops in (0, 5, 5, 9):
        kernel.arrive(drops=drops)
    bus.receive()
    assert bus.status.kernel_drops == 9
    kernel.link = Link(8, up=True, mtu=72)
    kernel.pass_time(SECOND)
    bus.receive()
    kernel.pass_time(SECOND)
    bus.receive()
    kernel.arrive(drops=2)  # the new socket counts from zero
    kernel.arrive(drops=0xFFFF_FFFF)
    kernel.arrive(drops=1)
    bus.receive()
    assert bus.status.kernel_drops == 9 + 0xFFFF_FFFF + 2


def test_error_frames_set_the_bus_state_and_data_ends_bus_off(kernel, bus):
    error(kernel, Frame(0, 0x004, bytes((0, 0x10, 0, 0, 0, 0, 0, 0)), ERROR))
    (frame,) = frames_of(bus)
    assert frame.flags == ERROR
    assert bus.status.bus_state is BusState.PASSIVE
    error(kernel, OFF)
    bus.receive()
    assert bus.status.bus_state is BusState.BUS_OFF
    assert bus.send(DATA) is SendResult.DOWN
    assert kernel.sockets[-1].sent == []  # nothing waits to leave stale after the recovery
    kernel.arrive()
    bus.receive()
    assert bus.status.bus_state is BusState.ACTIVE
    assert bus.send(DATA) is SendResult.SENT
    assert bus.status.error_frames == 2


def test_who_is_off_too_often_stays_silent_until_it_is_past(kernel, bus):
    def off():
        error(kernel, OFF)
        bus.receive()
        kernel.pass_time(10 * SECOND)
        kernel.arrive()
        bus.receive()

    for _ in range(3):
        off()
        assert bus.send(DATA) is SendResult.SENT
    off()
    assert bus.status.bus_state is BusState.ACTIVE
    assert bus.send(DATA) is SendResult.DOWN
    assert "4 bus-offs in a minute" in bus.status.note
    kernel.pass_time(20 * SECOND)
    assert bus.send(DATA) is SendResult.DOWN
    kernel.pass_time(SECOND)
    assert bus.send(DATA) is SendResult.SENT
    off()
    assert bus.status.bus_offs == 5


@pytest.mark.parametrize(
    ("code", "result"),
    [
        (errno.ENOBUFS, SendResult.FULL),
        (errno.EAGAIN, SendResult.FULL),
        (errno.EINVAL, SendResult.FAILED),
        (errno.EPERM, SendResult.FAILED),
        (errno.ENODEV, SendResult.DOWN),
        (errno.ENXIO, SendResult.DOWN),
    ],
)
def test_refused_sends_are_counted_and_never_tried_again(kernel, bus, code, result):
    kernel.sockets[-1].send_errors.append(problem(code))
    assert bus.send(DATA) is result
    assert kernel.sockets[-1].sent == []
    status = bus.status
    assert status.tx_full + status.tx_failed + status.tx_down == 1
    assert status.sent == 0


def test_a_pending_down_of_the_past_costs_no_frame(kernel, bus):
    kernel.sockets[-1].send_errors.append(problem(errno.ENETDOWN))
    assert bus.send(DATA) is SendResult.SENT
    kernel.sockets[-1].send_errors.extend([problem(errno.ENETDOWN), problem(errno.ENETDOWN)])
    assert bus.send(DATA) is SendResult.DOWN
    assert bus.status.state is LinkState.DOWN
    kernel.sockets[-1].send_errors.append(problem(errno.ENETDOWN))
    assert bus.send(DATA) is SendResult.DOWN  # known to be down: one try
    assert bus.status.sent == 1


def test_down_and_up_keep_the_socket(kernel, bus):
    kernel.sockets[-1].to_read.append(problem(errno.ENETDOWN))
    kernel.arrive()
    kernel.link = Link(7, up=False, mtu=72)
    assert len(frames_of(bus)) == 1  # what was received before is not lost
    assert bus.status.state is LinkState.DOWN
    kernel.link = Link(7, up=True, mtu=72)
    kernel.pass_time(SECOND)
    bus.receive()
    assert bus.status.state is LinkState.UP
    assert len(kernel.sockets) == 1
    assert bus.status.reopened == 0


def test_a_removed_interface_is_opened_again_when_it_is_back(kernel, bus):
    kernel.sockets[-1].to_read.append(problem(errno.ENODEV))
    kernel.link = None
    assert frames_of(bus) == []
    assert bus.status.state is LinkState.ABSENT
    assert kernel.sockets[-1].closed
    assert bus.send(DATA) is SendResult.DOWN
    kernel.pass_time(SECOND)
    assert frames_of(bus) == []
    kernel.link = Link(8, up=True, mtu=72)
    kernel.pass_time(100 * MS)
    bus.receive()
    assert len(kernel.sockets) == 1  # not before half a second has passed
    kernel.pass_time(400 * MS)
    bus.receive()
    assert bus.status.state is LinkState.UP
    assert bus.status.reopened == 1
    kernel.arrive()
    assert len(frames_of(bus)) == 1


def test_a_deaf_socket_is_noticed_by_the_index(kernel, bus):
    kernel.link = Link(8, up=True, mtu=72)  # deleted and made again; the socket says nothing
    kernel.pass_time(100 * MS)
    bus.receive()
    bus.receive()
    assert len(kernel.sockets) == 2
    assert kernel.sockets[0].closed
    assert bus.status.state is LinkState.UP
    assert bus.status.reopened == 1


def test_an_absent_interface_at_start_is_waited_for(kernel):
    kernel.link = None
    bus = SocketCan("vcan0", kernel=kernel)
    bus.open()
    assert bus.status.state is LinkState.ABSENT
    assert "vcan0 is not there" in bus.status.note
    assert frames_of(bus) == []
    kernel.link = Link(3, up=False, mtu=16)
    kernel.pass_time(SECOND)
    bus.receive()
    assert bus.status.state is LinkState.DOWN
    kernel.link = Link(3, up=True, mtu=16)
    kernel.pass_time(SECOND)
    bus.receive()
    assert bus.status.state is LinkState.UP
    assert bus.status.note == ""
    assert bus.status.reopened == 0


def test_a_kernel_without_can_is_a_configuration_error(kernel):
    kernel.refuse = problem(errno.EAFNOSUPPORT)
    bus = SocketCan("vcan0", kernel=kernel)
    with pytest.raises(ConfigError, match="no SocketCAN"):
        bus.open()
    kernel.refuse = problem(errno.EMFILE)
    bus.receive()  # once running nothing is raised
    kernel.pass_time(SECOND)
    assert frames_of(bus) == []
    assert "cannot be opened" in bus.status.note


def test_fd_needs_to_be_asked_for_and_a_classic_link_is_named(kernel):
    kernel.link = Link(7, up=True, mtu=16)
    fd_frame = Frame(0, 0x181, bytes(64), FD)
    classic = SocketCan("vcan0", kernel=kernel)
    classic.open()
    assert classic.send(fd_frame) is SendResult.FAILED
    fd = SocketCan("vcan0", fd=True, kernel=kernel)
    fd.open()
    assert "mtu 72" in fd.status.note
    assert fd.send(fd_frame) is SendResult.SENT


def test_close_may_come_twice_and_sends_are_refused_after(kernel, bus):
    bus.close()
    bus.close()
    assert bus.send(DATA) is SendResult.DOWN
    assert kernel.sockets[-1].closed


class Asker(Links):
    """What netlink says, as the test wants it."""

    def __init__(self, kernel):
        super().__init__("vcan0")
        self.kernel = kernel
        self.asked = 0
        self.facts = Facts(7, True, "can", BusState.ACTIVE, 100, 0, 0, 10)
        self.allowed = True
        self.hurried = 0
        self.closed = 0

    def start(self):
        return self.allowed

    def say(self, state, ifindex=7):
        self.asked = self.kernel.mono
        self.facts = self.facts._replace(state=state, ifindex=ifindex)

    def news(self):
        return self.asked, self.facts

    def advice(self):
        return ["vcan0: do this"] if self.asked == 0 else []

    def hurry(self):
        self.hurried += 1

    def close(self):
        self.closed += 1


@pytest.fixture
def asker(kernel):
    return Asker(kernel)


@pytest.fixture
def watched(kernel, asker):
    bus = SocketCan("vcan0", links=asker, kernel=kernel)
    bus.open()
    kernel.pass_time(MS)
    return bus


def look(kernel, bus):
    kernel.pass_time(100 * MS)
    bus.receive()
    return bus.status.bus_state


def test_netlink_tells_of_a_bus_off_whose_error_frame_was_lost(kernel, watched, asker):
    asker.say(BusState.BUS_OFF)
    assert look(kernel, watched) is BusState.BUS_OFF
    assert look(kernel, watched) is BusState.BUS_OFF
    assert watched.status.bus_offs == 1
    assert watched.send(DATA) is SendResult.DOWN
    asker.say(BusState.ACTIVE)
    assert look(kernel, watched) is BusState.ACTIVE
    assert watched.send(DATA) is SendResult.SENT


def test_an_answer_from_before_an_error_frame_does_not_count(kernel, watched, asker):
    asker.say(BusState.ACTIVE)
    kernel.pass_time(10 * MS)
    error(kernel, OFF)
    watched.receive()
    assert asker.hurried == 1
    assert look(kernel, watched) is BusState.BUS_OFF
    asker.say(BusState.BUS_OFF)
    assert look(kernel, watched) is BusState.BUS_OFF
    assert watched.status.bus_offs == 1
    error(kernel, RESTARTED)
    assert look(kernel, watched) is BusState.ACTIVE


def test_an_answer_from_before_a_down_is_no_second_bus_off(kernel, watched, asker):
    asker.say(BusState.BUS_OFF)
    look(kernel, watched)
    assert kernel.link is not None
    for up in (False, True):
        kernel.link = kernel.link._replace(up=up)
        assert look(kernel, watched) is BusState.ACTIVE
    assert watched.status.bus_offs == 1


def test_data_does_not_end_a_bus_off_that_netlink_can_deny(kernel, watched, asker):
    asker.say(BusState.BUS_OFF)
    look(kernel, watched)
    kernel.arrive()
    assert look(kernel, watched) is BusState.BUS_OFF


def test_a_link_without_a_controller_and_another_link_say_nothing(kernel, watched, asker):
    asker.say(None)
    assert look(kernel, watched) is BusState.ACTIVE
    asker.say(BusState.BUS_OFF, ifindex=8)
    assert look(kernel, watched) is BusState.ACTIVE


def test_advice_is_logged_and_the_asker_ends_with_the_bus(kernel, asker, caplog):
    bus = SocketCan("vcan0", links=asker, kernel=kernel)
    bus.open()
    assert "vcan0: do this" in caplog.text
    kernel.link = None
    look(kernel, bus)
    assert (bus.status.state, asker.closed) == (LinkState.ABSENT, 0)
    bus.close()
    assert asker.closed == 1


def test_where_netlink_is_forbidden_error_frames_do(kernel, asker, caplog):
    asker.allowed = False
    bus = SocketCan("vcan0", links=asker, kernel=kernel)
    bus.open()
    assert "netlink is not allowed" in caplog.text
    error(kernel, OFF)
    assert look(kernel, bus) is BusState.BUS_OFF
    kernel.arrive()
    assert look(kernel, bus) is BusState.ACTIVE


def test_nothing_is_queued_behind_what_still_waits(kernel):
    bus = SocketCan("vcan0", newest=True, kernel=kernel)
    bus.open()
    assert bus.send(DATA) is SendResult.SENT
    kernel.waiting = 768
    assert bus.send(DATA) is SendResult.SENT  # the same tick: its frames belong together
    for _ in range(12):
        bus.receive()
        assert bus.send(DATA) is SendResult.FULL
    assert bus.status.tx_full == 12
    assert "no new ones are added" in bus.status.note
    kernel.waiting = 0  # gone between the read and the send
    assert bus.send(DATA) is SendResult.SENT
    bus.receive()
    assert bus.send(DATA) is SendResult.SENT
    assert len(kernel.sockets[-1].sent) == 4


def test_simulated_drives_may_queue(kernel, bus):
    kernel.waiting = 768
    bus.receive()
    assert bus.send(DATA) is SendResult.SENT
