"""Reading ahead: nothing is lost, reordered, or raised anywhere else than where it belongs."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from dbc.prefetch import ahead


def test_the_items_in_their_order_made_by_another_thread() -> None:
    makers = set()

    def items() -> Iterator[int]:
        for k in range(100):
            makers.add(threading.get_ident())
            yield k

    assert list(ahead(items())) == list(range(100))
    assert len(makers) == 1
    assert threading.get_ident() not in makers


def test_the_next_is_made_while_one_is_looked_at_and_no_more() -> None:
    made: list[int] = []
    two = threading.Event()

    def items() -> Iterator[int]:
        for k in range(10):
            made.append(k)
            if k == 1:
                two.set()
            yield k

    stream = ahead(items())
    assert next(stream) == 0
    assert two.wait(10.0)
    assert made == [0, 1]
    stream.close()


def test_what_making_one_raises_comes_behind_those_before() -> None:
    def items() -> Iterator[int]:
        yield 1
        yield 2
        msg = "line 3"
        raise ValueError(msg)

    stream = ahead(items())
    assert [next(stream), next(stream)] == [1, 2]
    with pytest.raises(ValueError, match="line 3"):
        next(stream)


def test_who_stops_early_leaves_no_thread() -> None:
    before = threading.active_count()
    stream = ahead(iter(range(1000)))
    next(stream)
    stream.close()
    assert threading.active_count() == before
