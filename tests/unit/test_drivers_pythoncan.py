"""The python-can transport over its `virtual` bus, and over buses that fail."""

import errno
import time

import can
import pytest

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, SECOND, Frame
from dbc.logs.python_can import from_message, to_message
from gateway.io.pythoncan import PythonCan
from gateway.io.transport import LinkState, SendResult
from gateway.settings.config import ConfigError
from tests.buses import Clock, frames_of

FRAMES = [
    Frame(0, 0x181, b"\x01\x02\x03", 0, "bus"),
    Frame(0, 0x1ABCDEF0, bytes(8), EXTENDED, "bus"),
    Frame(0, 0x181, b"", REMOTE, "bus", 4),
    Frame(0, 0x181, b"", REMOTE, "bus"),
    Frame(0, 0x181, bytes(range(64)), FD | BRS, "bus"),
    Frame(0, 0x181, bytes(12), FD | ESI, "bus"),
]


@pytest.mark.parametrize("frame", FRAMES)
def test_frames_survive_the_way_through_a_message(frame):
    assert from_message(to_message(frame)) == frame


@pytest.fixture
def pair():
    options = {"interface": "virtual", "channel": "pair", "fd": True}
    a, b = PythonCan(options), PythonCan(options)
    a.open()
    b.open()
    yield a, b
    a.close()
    b.close()


def test_what_one_sends_the_other_receives_in_one_batch(pair):
    a, b = pair
    before = time.monotonic_ns()
    for frame in FRAMES:
        assert a.send(frame) is SendResult.SENT
    begun = time.monotonic_ns()
    received = frames_of(b)
    after = time.monotonic_ns()
    slack = 50 * MS + after - begun  # two clocks are read one after the other
    assert [f._replace(t_ns=0, channel="bus") for f in received] == FRAMES
    stamps = [f.t_ns for f in received]
    assert stamps == sorted(stamps)
    assert all(before - slack <= t <= after for t in stamps)
    assert frames_of(a) == []  # own frames do not come back
    assert (a.status.sent, b.status.received) == (len(FRAMES), len(FRAMES))


def test_error_frames_are_flagged_and_move_the_bus_state():
    receiver = PythonCan({"interface": "virtual", "channel": "errors"})
    receiver.open()
    with can.Bus(interface="virtual", channel="errors") as sender:
        sender.send(can.Message(is_error_frame=True, arbitration_id=0x040, data=bytes(8)))
    (frame,) = frames_of(receiver)
    assert (frame.can_id, frame.flags) == (0x040, ERROR)
    assert receiver.status.bus_state.value == "bus-off"
    receiver.close()


def test_fd_needs_to_be_asked_for():
    bus = PythonCan({"interface": "virtual", "channel": "classic"})
    bus.open()
    assert bus.send(FRAMES[4]) is SendResult.FAILED
    assert bus.send(Frame(0, 0x181, bytes(9))) is SendResult.FAILED
    assert bus.status.tx_failed == 2
    bus.close()
    assert bus.send(FRAMES[0]) is SendResult.DOWN


@pytest.mark.filterwarnings("ignore")  # of those that were made by half
@pytest.mark.parametrize("name", sorted(can.VALID_INTERFACES - {"socketcan", "udp_multicast"}))
def test_without_the_makers_library_each_interface_is_refused_or_waited_for(name):
    bus = PythonCan({"interface": name, "channel": "0"})
    refused = ""
    try:
        bus.open()
    except ConfigError as error:
        refused = str(error)
    up = name == "virtual"
    assert refused.startswith(f"interface {name}: ") or bus.status.state is (
        LinkState.UP if up else LinkState.ABSENT
    )
    bus.close()


def test_unknown_interface_or_option_is_a_configuration_error():
    with pytest.raises(ConfigError, match="nonsense"):
        PythonCan({"interface": "nonsense", "channel": "0"}).open()


class BadBus(can.BusABC):
    """A device that can be absent, break while reading, or refuse to send."""

    absent = False
    broken = False
    send_error: int | None = None
    made = 0

    def __init__(self, channel=None, **_):
        if BadBus.absent:
            raise can.CanInitializationError("device unplugged")
        super().__init__(channel=channel)
        BadBus.made += 1

    def _recv_internal(self, timeout):
        if BadBus.broken:
            raise can.CanOperationError("device unplugged")
        return None, True

    def send(self, msg, timeout=None):
        if BadBus.send_error is not None:
            raise can.CanOperationError("transmit", BadBus.send_error)


@pytest.fixture
def bad(monkeypatch):
    monkeypatch.setattr(can, "Bus", lambda **options: BadBus(channel=options["channel"]))
    for name, value in (("absent", False), ("broken", False), ("send_error", None), ("made", 0)):
        monkeypatch.setattr(BadBus, name, value)
    return BadBus


def test_an_absent_device_is_waited_for_and_a_lost_one_opened_again(bad):
    clock = Clock()
    bad.absent = True
    bus = PythonCan({"interface": "x", "channel": "0"}, clock, clock)
    bus.open()
    assert bus.status.state is LinkState.ABSENT
    assert "device unplugged" in bus.status.note
    bad.absent = False
    assert frames_of(bus) == []
    assert bad.made == 0  # half a second has not passed
    clock.now += SECOND
    assert frames_of(bus) == []
    assert (bus.status.state, bus.status.reopened) == (LinkState.UP, 0)
    bad.broken = True
    assert frames_of(bus) == []
    assert bus.status.state is LinkState.ABSENT
    bad.broken = False
    clock.now += SECOND
    bus.receive()
    assert (bus.status.state, bus.status.reopened, bad.made) == (LinkState.UP, 1, 2)
    bus.close()


@pytest.mark.parametrize(
    ("code", "result"),
    [(errno.ENOBUFS, SendResult.FULL), (errno.EIO, SendResult.FAILED), (0, SendResult.FAILED)],
)
def test_refused_sends_are_counted(bad, code, result):
    bus = PythonCan({"interface": "x", "channel": "0"})
    bus.open()
    bad.send_error = code
    assert bus.send(FRAMES[0]) is result
    assert bus.status.tx_full + bus.status.tx_failed == 1
    bus.close()


def test_a_device_with_its_own_epoch_is_stamped_between_two_reads():
    mono, real = Clock(), Clock()
    options = {"interface": "virtual", "channel": "epoch", "preserve_timestamps": True}
    bus = PythonCan(options, mono, real)
    bus.open()
    with can.Bus(**options) as sender:
        mono.now += 7 * MS
        for stamp in (0.0, 12.5, 4e9):
            sender.send(can.Message(timestamp=stamp, arbitration_id=1, is_extended_id=False))
        stamps = [f.t_ns for f in frames_of(bus)]
    assert stamps == [mono.now - 7 * MS, mono.now - 7 * MS, mono.now]
    bus.close()
