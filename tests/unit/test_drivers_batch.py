"""Batched reading against the reading of one frame, and over a real socket of the kernel."""

import errno
import socket
import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dbc.frame import SECOND
from gateway.io.batch import Batch
from gateway.io.transport import monotonic_stamp
from tests.fuzz import examples
from tests.messages import put
from tests.reference.socketcan import unpack

REAL, NOW = 1_790_000_000 * SECOND, 50 * SECOND


def stamp(ns):
    return (socket.SOL_SOCKET, 35, struct.pack("@ll", *divmod(ns, SECOND)))


def drops(count):
    return (socket.SOL_SOCKET, 40, struct.pack("=I", count))


classic = st.builds(
    lambda word, length, pad, raw, data: struct.pack("=IBBBB", word, length, pad, 0, raw) + data,
    st.integers(0, 0xFFFF_FFFF), st.integers(0, 255), st.integers(0, 255), st.integers(0, 255),
    st.binary(min_size=8, max_size=8),
)  # fmt: skip
fd = st.builds(
    lambda word, length, flags, data: struct.pack("=IBBBB", word, length, flags, 0, 0) + data,
    st.integers(0, 0xFFFF_FFFF), st.integers(0, 255), st.integers(0, 255),
    st.binary(min_size=64, max_size=64),
)  # fmt: skip


def _head(word, length, raw=0):
    """A classic frame of zeros."""
    return struct.pack("=IBBBB", word, length, 0, 0, raw) + bytes(8)


# A remote request whose length byte is far above 8.
_LONG_REQUEST = struct.pack("=IBBBB", 0x4000_0000, 128, 0, 0, 0) + bytes(8)


@settings(max_examples=examples(500))
@example([(_LONG_REQUEST, 0)])
@example([(_head(0x181, 8), -1), (_head(0x181, 8), -(10**9))])  # stamps ahead of the clock
@example([(_head(0x4000_0181, 3), 0), (_head(0x4000_0181, 0), 0), (_head(0x4000_0181, 8, 13), 0)])
@example([(_head(0x181, 8, raw), 0) for raw in (13, 16, 8, 15)])
@given(st.lists(st.tuples(st.one_of(classic, fd, st.binary(max_size=90)), st.integers(0, 10**9))))
def test_rows_are_what_the_reading_of_one_frame_gives(items):
    batch = Batch(64)
    items = items[:64]
    for payload, age in items:
        put(batch, payload, [stamp(REAL - age)])
    block, malformed, errors, dropped = batch.to_block(REAL, NOW, SECOND // 2, "vcan0")
    wanted = [
        unpack(payload, monotonic_stamp(REAL - age, REAL, NOW, SECOND // 2), "vcan0")
        for payload, age in items
    ]
    frames = [frame for frame in wanted if frame is not None]
    assert list(block.frames()) == frames
    assert malformed == len(items) - len(frames)
    assert errors == sum(frame.flags & 4 > 0 for frame in frames)
    assert dropped == 0
    for data, length in zip(block.data, block.length.tolist(), strict=True):
        assert not data[length:].any()


def test_stamps_drops_and_unknown_control_in_any_order():
    batch = Batch(8)
    frame = struct.pack("=IBBBB", 0x181, 1, 0, 0, 0) + bytes(8)
    other = (socket.SOL_SOCKET, 99, b"abc")
    put(batch, frame, [drops(3), other, (socket.SOL_SOCKET, 99, b""), stamp(REAL - 5)])
    put(batch, frame, [other])
    put(batch, frame, [(1234, 35, struct.pack("@ll", 1, 1)), drops(7)])
    block, _, _, dropped = batch.to_block(REAL, NOW, SECOND, "vcan0")
    assert block.t_ns.tolist() == [NOW - 5, NOW, NOW]
    assert dropped == 7
    put(batch, frame, [drops(9)])
    assert batch.to_block(REAL, NOW, SECOND, "vcan0")[3] == 2
    batch.begin()
    put(batch, frame, [drops(4)])
    assert batch.to_block(REAL, NOW, SECOND, "vcan0")[3] == 4


def test_control_that_is_cut_off_or_too_short_is_not_read():
    batch = Batch(4)
    frame = struct.pack("=IBBBB", 0x181, 1, 0, 0, 0) + bytes(8)
    level, kind, data = stamp(REAL - 5)
    put(batch, frame, [(level, kind, data[:8]), (socket.SOL_SOCKET, 40, b"ab")])
    put(batch, frame, [(level, kind, data)])
    batch.control_sizes[1] -= 4
    put(batch, frame, [(level, kind, data)])
    # A head that says less than its own size.
    batch.control[2, :8] = 0
    block, _, _, dropped = batch.to_block(REAL, NOW, SECOND, "vcan0")
    assert block.t_ns.tolist() == [NOW] * 3
    assert dropped == 0


def test_what_was_taken_stays_when_the_room_is_filled_again():
    batch = Batch(2)
    put(batch, struct.pack("=IBBBB", 0x181, 1, 0, 0, 0) + b"\x01" * 8, [])
    first, *_ = batch.to_block(REAL, NOW, SECOND, "vcan0")
    put(batch, struct.pack("=IBBBB", 0x182, 1, 0, 0, 0) + b"\x02" * 8, [])
    batch.to_block(REAL, NOW, SECOND, "vcan0")
    assert (first.can_id.item(0), first.data.item(0, 0)) == (0x181, 1)


def test_a_real_socket_is_read_in_one_call_until_it_is_empty_or_the_room_is_full():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    batch = Batch(4)
    with ours, theirs:
        with pytest.raises(BlockingIOError):
            batch.read_from(ours.fileno())
        for k in range(6):
            theirs.send(struct.pack("=IBBBB", 0x180 + k, 2, 0, 0, 0) + bytes([k] * 8))
        assert not batch.read_from(ours.fileno())
        assert batch.full
        block, *_ = batch.to_block(REAL, NOW, SECOND, "x")
        assert [frame.can_id for frame in block.frames()] == [0x180, 0x181, 0x182, 0x183]
        theirs.send(bytes(100))
        theirs.send(bytes(72))
        assert not batch.read_from(ours.fileno())
        block, malformed, _, _ = batch.to_block(REAL, NOW, SECOND, "x")
        assert [frame.can_id for frame in block.frames()] == [0x184, 0x185, 0]
        assert [frame.data for frame in block.frames()] == [b"\4\4", b"\5\5", b""]
        assert malformed == 1
        theirs.send(bytes(16))
        assert batch.read_from(ours.fileno())
        assert batch.filled == 1
    with pytest.raises(OSError, match="descriptor") as closed:
        batch.read_from(ours.fileno())
    assert closed.value.errno == errno.EBADF


def test_the_kernels_own_stamp_is_read():
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    batch = Batch(2)
    with receiver, sender:
        receiver.bind(("127.0.0.1", 0))
        for option in (0, 1):  # behind a message without a stamp there is room for one again
            receiver.setsockopt(socket.SOL_SOCKET, 35, option)
            sender.sendto(bytes(16), receiver.getsockname())
            receiver.recv(16, socket.MSG_PEEK)
            batch.read_from(receiver.fileno())
            # Of a clock that is past 2020, and before the year 2200.
            block, *_ = batch.to_block(7_000_000_000 * SECOND, 8_000_000_000 * SECOND, 1 << 62, "x")
    assert 1_577_836_800 < block.t_ns.item(0) / SECOND - 1_000_000_000 < 7_000_000_000
