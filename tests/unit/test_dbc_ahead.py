"""Reading ahead, blocks of frames, other formats by python-can: nothing lost or reordered."""

import threading

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, SECOND, TX, Frame
from dbc.frames import EMPTY, block_of, in_blocks, join
from dbc.logs.opening import open_reader
from dbc.logs.python_can import from_message, to_message
from dbc.prefetch import ahead
from gateway.logfiles.convert import frame_sink
from tests.fuzz import examples
from tests.strategies import frames


def test_the_items_in_their_order_made_by_another_thread():
    makers = set()

    def items():
        for k in range(100):
            makers.add(threading.get_ident())
            yield k

    assert list(ahead(items())) == list(range(100))
    assert len(makers) == 1
    assert threading.get_ident() not in makers


def test_the_next_is_made_while_one_is_looked_at_and_no_more():
    made = []
    two = threading.Event()

    def items():
        for k in range(10):
            made.append(k)
            if k == 1:
                two.set()
            yield k

    stream = ahead(items())
    assert next(stream) == 0
    assert two.wait(60.0)
    assert made == [0, 1]
    stream.close()


def test_what_making_one_raises_comes_behind_those_before():
    def items():
        yield 1
        yield 2
        msg = "line 3"
        raise ValueError(msg)

    stream = ahead(items())
    assert [next(stream), next(stream)] == [1, 2]
    with pytest.raises(ValueError, match="line 3"):
        next(stream)


def test_who_stops_early_leaves_no_thread():
    before = set(threading.enumerate())  # some of which may end meanwhile
    stream = ahead(iter(range(1000)))
    next(stream)
    stream.close()
    assert not set(threading.enumerate()) - before


T0 = 1_700_000_000.0
MESSAGES = [
    can.Message(T0, 0x181, is_extended_id=False, data=bytes(8), channel=0),
    can.Message(T0 + 0.002, 0x18FEF100, is_extended_id=True, data=b"\1\2", channel=0),
    can.Message(T0 + 0.004, 0x182, is_extended_id=False, is_remote_frame=True, dlc=4, channel=0),
    can.Message(
        T0 + 0.006, 0x183, is_extended_id=False, is_fd=True, bitrate_switch=True,
        data=bytes(range(64)), channel=0,
    ),
]  # fmt: skip


SENT = [
    Frame(round(T0) * SECOND, 0x181, b"\1", TX, "0"),
    Frame(round(T0) * SECOND + MS, 0x182, b"\2", 0, "0"),
    Frame(round(T0) * SECOND + 2 * MS, 0x18FEF100, b"\3", EXTENDED | TX, "0"),
    Frame(round(T0) * SECOND + 3 * MS, 0x183, bytes(12), FD | TX, "0"),
    Frame(round(T0) * SECOND + 4 * MS, 0x184, b"", REMOTE | TX, "0", 2),
]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4"])
def test_python_can_and_we_mean_the_same_by_sent(tmp_path, suffix):
    ours, theirs = tmp_path / f"ours{suffix}", tmp_path / f"theirs{suffix}"
    sink = frame_sink(ours, suffix)
    sink.add(block_of(SENT))
    sink.close()
    with can.LogReader(ours) as reader:
        seen = sorted((m.arbitration_id, m.is_rx) for m in reader)
    assert seen == sorted((f.can_id, not f.flags & TX) for f in SENT)
    with can.Logger(theirs) as logger:
        for frame in SENT[:4]:
            logger(to_message(frame))
    assert sorted((f.can_id, f.flags) for f in open_reader(theirs, strict=False)) == sorted(
        (f.can_id, f.flags) for f in SENT[:4]
    )


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
def test_error_frames_of_a_file(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    error = can.Message(T0, 0x40, is_error_frame=True, is_extended_id=False, channel=0)
    with can.Logger(path) as logger:
        logger(error)
        logger(MESSAGES[0])
    assert [f.flags for f in open_reader(path, strict=False)] == [ERROR, 0]


def test_remote_length_and_channel():
    assert from_message(MESSAGES[2])._replace(t_ns=0) == Frame(0, 0x182, b"", REMOTE, "0", 4)


LISTS = st.lists(frames(), max_size=12)


@given(LISTS)
@settings(max_examples=examples(50))
def test_there_and_back(wanted):
    block = block_of(wanted)
    assert list(block.frames()) == wanted
    assert block.size == len(wanted)


@given(LISTS, LISTS)
@settings(max_examples=examples(50))
def test_join_is_one_after_the_other(first, second):
    assert list(join(block_of(first), block_of(second)).frames()) == first + second


@given(LISTS, st.integers(1, 5))
@settings(max_examples=examples(50))
def test_blocks_of_a_size(wanted, size):
    blocks = list(in_blocks(iter(wanted), size))
    assert [f for block in blocks for f in block.frames()] == wanted
    assert all(0 < block.size <= size for block in blocks)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=12))
@settings(max_examples=examples(50))
def test_order_is_by_time_then_id_and_stable(keys):
    rows = [Frame(t, i, bytes([n])) for n, (t, i) in enumerate(keys)]
    wanted = sorted(rows, key=lambda f: (f.t_ns, f.can_id))
    assert list(block_of(rows).ordered().frames()) == wanted


def test_what_came_before_a_fault_is_given_first():
    def broken():
        yield Frame(1, 2)
        raise OSError

    blocks = in_blocks(broken())
    assert list(next(blocks).frames()) == [Frame(1, 2)]
    with pytest.raises(OSError):
        next(blocks)


def test_data_longer_than_any_frame_is_seen_by_its_length():
    block = block_of([Frame(0, 1, bytes(300))])
    assert block.length.tolist() == [255]
    assert EMPTY.size == 0
