"""Frames as SocketCAN's structures, byte for byte, and simulated drives in real time."""

import pytest

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, MS, REMOTE, Frame
from gateway.hil import simbus
from gateway.hil.simbus import NEWEST, NEWEST_FD, newest, run_on_bus
from gateway.io.live import Stop
from gateway.io.wire import BusState, bus_state, pack
from tests.buses import Bus
from tests.reference.socketcan import unpack

BYTES = [
    (Frame(0, 0x123, b"\x11\x22"), "23010000 02000000 1122000000000000"),
    (Frame(0, 0x7FF, bytes(range(8))), "ff070000 08000000 0001020304050607"),
    (Frame(0, 0x123, bytes(8), 0, "", 15), "23010000 0800000f 0000000000000000"),
    (Frame(0, 0x1ABCDEF0, b"\xaa", EXTENDED), "f0debc9a 01000000 aa00000000000000"),
    (Frame(0, 0x181, b"", REMOTE, "", 4), "81010040 04000000 0000000000000000"),
    (Frame(0, 0x181, b"", REMOTE), "81010040 00000000 0000000000000000"),
    (Frame(0, 0x181, b"", REMOTE, "", 12), "81010040 0800000c 0000000000000000"),
    (Frame(0, 0x181, bytes(range(64)), FD | BRS), "81010000 40010000" + bytes(range(64)).hex()),
    (Frame(0, 0x181, b"\x01", FD | ESI), "81010000 01020000 01" + "00" * 63),
]


@pytest.mark.parametrize(("frame", "text"), BYTES)
def test_known_bytes_both_ways(frame, text):
    payload = bytes.fromhex(text)
    assert len(payload) in (16, 72)
    assert pack(frame) == payload
    assert unpack(payload, 0, "") == frame


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, 0x800, b""), Frame(0, -1, b""), Frame(0, 0x2000_0000, b"", EXTENDED),
        Frame(0, 0x123, bytes(9)), Frame(0, 0x123, bytes(9), FD), Frame(0, 0x123, bytes(65), FD),
        Frame(0, 0x123, b"", FD | REMOTE), Frame(0, 0x040, bytes(8), ERROR),
    ],
)  # fmt: skip
def test_what_no_bus_carries_is_not_packed(frame):
    assert pack(frame) is None


@pytest.mark.parametrize("size", [0, 1, 15, 17, 71, 73, 2060])
def test_other_sizes_are_no_frames(size):
    assert unpack(bytes(size), 0, "") is None


def test_error_frames_are_flagged_and_keep_their_class():
    bus_off = bytes.fromhex("40000020 08000000 0000000000000000")
    frame = unpack(bus_off, 5, "can0")
    assert frame == Frame(5, 0x040, bytes(8), ERROR, "can0")
    assert not frame.is_plain_data


def test_the_fd_mark_of_newer_kernels_changes_nothing():
    marked = bytes.fromhex("81010000 01050000 01" + "00" * 63)
    assert unpack(marked, 0, "") == Frame(0, 0x181, b"\x01", FD | BRS)


def test_lengths_beyond_the_structure_cannot_read_outside():
    frame = unpack(bytes.fromhex("23010000 ff000000 0102030405060708"), 0, "")
    assert frame is not None
    assert frame.data == bytes(range(1, 9))


@pytest.mark.parametrize(
    ("error_class", "detail", "state"),
    [
        (0x004, 0x04, BusState.WARNING), (0x004, 0x08, BusState.WARNING),
        (0x004, 0x10, BusState.PASSIVE), (0x204, 0x20, BusState.PASSIVE),
        (0x004, 0x40, BusState.ACTIVE), (0x040, 0x00, BusState.BUS_OFF),
        (0x100, 0x00, BusState.ACTIVE),
    ],
)  # fmt: skip
def test_error_frames_tell_the_bus_state(error_class, detail, state):
    data = bytes((0, detail, 0, 0, 0, 0, 0, 0))
    for before in BusState:
        assert bus_state(Frame(0, error_class, data, ERROR), before) is state


@pytest.mark.parametrize("error_class", [0x001, 0x002, 0x008, 0x020, 0x080, 0x200])
def test_other_errors_leave_the_bus_state(error_class):
    for before in BusState:
        assert bus_state(Frame(0, error_class, bytes(8), ERROR), before) is before
    assert bus_state(Frame(0, 0x004, b"", ERROR), BusState.PASSIVE) is BusState.PASSIVE


class One(Bus):
    """Delivers one frame."""

    def __init__(self):
        super().__init__()
        self.waiting = [Frame(0, 0x1A0, b"\0")]

    def waiting_frames(self):
        frames, self.waiting = self.waiting, []
        return frames


class World:
    """One frame per millisecond of its time."""

    fastest_cycle_ns = 2 * MS

    def __init__(self):
        self.heard = []
        self.times = []

    def step(self, frames, now_ns):
        self.heard += frames
        done = self.times[-1] if self.times else -MS
        self.times.append(now_ns)
        return [Frame(t, 0x181, b"") for t in range(done // MS * MS + MS, now_ns + 1, MS)]


def test_of_every_id_the_newest_are_held():
    fast = [Frame(k, 0x181, bytes((k,))) for k in range(NEWEST + 3)]
    fd = [Frame(k, 0x182, bytes((k,)), FD) for k in range(NEWEST_FD + 1)]
    slow = [Frame(0, 0x1C1, b"late, but the only one")]
    assert newest([*slow, *fast, *fd]) == [*slow, *fast[3:], *fd[1:]]
    assert newest(fast[:NEWEST]) == fast[:NEWEST]
    assert newest([]) == []


def test_the_world_runs_to_its_end_in_real_time():
    bus, world = One(), World()
    lost = run_on_bus(world, bus, 0.02, lambda: None)
    assert world.times[0] == 0
    assert world.times[-1] == 20 * MS
    assert world.times == sorted(world.times)
    assert len(bus.sent) + lost == 21
    assert world.heard == [Frame(0, 0x1A0, b"\0")]
    assert bus.calls[-1] == "close"


def test_a_stall_is_caught_up_but_not_sent(monkeypatch):
    bus, world = One(), World()
    stamps = iter((0, 0, 100 * MS, 100 * MS))

    class Stalling(simbus.Ticker):
        def __init__(self, period_ns):
            super().__init__(period_ns, clock=lambda: next(stamps), sleep=lambda _: None)

    monkeypatch.setattr(simbus, "Ticker", Stalling)
    lost = run_on_bus(world, bus, 0.1, lambda: None)
    assert world.times == [0, 100 * MS]
    assert [f.t_ns // MS for f in bus.sent] == [0, *range(101 - NEWEST, 101)]
    assert lost == 100 - NEWEST


def test_a_stop_ends_it_and_the_bus_is_given_back():
    bus, world, stop = One(), World(), Stop()
    run_on_bus(world, bus, 3600.0, stop, stop)
    assert len(world.times) == 1
    assert bus.calls[-1] == "close"
