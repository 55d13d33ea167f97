"""Bits on the wire against counts by hand and the standard's checksum."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc import wire_time as ours
from dbc.frame import BRS, EXTENDED, FD, Frame
from tests.fuzz import examples
from tests.reference import stuffing


def test_the_checksum_is_can_s():
    """CRC-15/CAN of "123456789" is 0x059E in every catalogue."""
    bits = [byte >> k & 1 for byte in b"123456789" for k in range(7, -1, -1)]
    assert stuffing.crc15(bits) == 0x059E


def bits_of(frame):
    """Of one frame, by both: the whole and the reference agree."""
    [nominal], [data] = ours.bits_of([frame])
    assert (nominal, data) == stuffing.bits_of(frame)
    return stuffing.Bits(int(nominal), int(data))


frames = st.builds(
    lambda can_id, extended, data: Frame(
        0, can_id if extended else can_id & 0x7FF, data, EXTENDED if extended else 0
    ),
    st.integers(0, 0x1FFFFFFF), st.booleans(), st.binary(max_size=8),
)  # fmt: skip
fd_frames = st.builds(
    lambda frame, length, fill, switch: frame._replace(
        data=(frame.data + bytes([fill]) * 64)[:length], flags=frame.flags | FD | BRS * switch
    ),
    frames, st.sampled_from(stuffing.FD_LENGTHS), st.sampled_from([0, 0xFF, 0x1F, 0x55]),
    st.booleans(),
)  # fmt: skip


@settings(max_examples=examples(100))
@given(st.lists(frames | fd_frames, max_size=20))
def test_many_frames_at_once_have_the_bits_of_each(many):
    nominal, data = ours.bits_of(many)
    assert list(zip(nominal, data, strict=True)) == [stuffing.bits_of(f) for f in many]


@pytest.mark.parametrize(
    ("bits", "count"),
    [
        ([0] * 4, 0),
        ([0] * 5, 1),
        ([0] * 9, 1),
        ([0] * 10, 2),
        ([0] * 5 + [1] * 4, 2),
        ([0, 1] * 20, 0),
    ],
)
def test_a_stuff_bit_counts_for_the_next_run(bits, count):
    """0 0 0 0 0 (1) 1 1 1 1 (0): the stuff bit is the first of the four."""
    assert stuffing.stuff_bits(bits)[0] == count


def test_lengths_without_stuffing():
    """11 bits and 8 bytes: 108 bits and three of intermission; 29 bits: 20 more."""
    frame = Frame(0, 0x555, bytes([0x55] * 8))
    bare = 111
    assert bits_of(frame).nominal == bare + 1  # one stuff bit, in the checksum
    assert bits_of(frame._replace(data=b"")).nominal >= bare - 64
    extended = frame._replace(can_id=0x15555555, flags=EXTENDED)
    assert bare + 20 <= bits_of(extended).nominal <= bare + 20 + 4


@settings(max_examples=examples(200))
@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_classic_frame_is_longer_than_the_worst_case(can_id, data):
    bits = bits_of(Frame(0, can_id, data))
    n = len(data)
    assert 47 + 8 * n <= bits.nominal <= ours.longest_seconds(n, 1.0)
    assert bits.data == 0


@settings(max_examples=examples(50))
@given(st.binary(min_size=64, max_size=64), st.sampled_from(stuffing.FD_LENGTHS), st.booleans())
def test_no_fd_frame_is_longer_than_the_worst_case(data, length, switch):
    bits = bits_of(Frame(0, 0x123, data[:length], FD | (BRS if switch else 0)))
    # ESI, length code and data, stuff count and CRC with fixed stuff bits, delimiter.
    fixed = 6 + 8 * length + (4 + 21 + 7 if length > 16 else 4 + 17 + 6)
    assert bits.nominal >= 29 + fixed * (not switch)
    assert bits.data >= fixed * switch
    longest = ours.longest_seconds(length, 1e6, 5e6 if switch else 1e6)
    assert bits.seconds(1_000_000, 5_000_000) <= longest


def test_a_length_that_can_fd_has_not_is_refused():
    with pytest.raises(ValueError, match="9"):
        bits_of(Frame(0, 1, bytes(9), FD))
