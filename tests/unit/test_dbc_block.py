"""Blocks and lists of frames say the same."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.frame import Frame
from dbc.frames import EMPTY, block_of, in_blocks, join
from tests.fuzz import examples
from tests.strategies import frames

LISTS = st.lists(frames(), max_size=12)


@given(LISTS)
@settings(max_examples=examples(200))
def test_there_and_back(wanted):
    block = block_of(wanted)
    assert list(block.frames()) == wanted
    assert block.size == len(wanted)


@given(LISTS, LISTS)
@settings(max_examples=examples(200))
def test_join_is_one_after_the_other(first, second):
    assert list(join(block_of(first), block_of(second)).frames()) == first + second


@given(LISTS, st.integers(1, 5))
@settings(max_examples=examples(100))
def test_blocks_of_a_size(wanted, size):
    blocks = list(in_blocks(iter(wanted), size))
    assert [f for block in blocks for f in block.frames()] == wanted
    assert all(0 < block.size <= size for block in blocks)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=12))
@settings(max_examples=examples(200))
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
