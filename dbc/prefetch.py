"""Work that another thread does ahead: reading goes on while what was read is looked at."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")


def ahead(items: Iterator[T]) -> Iterator[T]:
    """The same items (none of them None), the next one made while the last is looked at.

    What making one raises is raised in its place. Pays where making them leaves Python to others,
    as compiled loops and zlib do.
    """
    # Here, because a live gateway starts without.
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        following = pool.submit(next, items, None)
        while (item := following.result()) is not None:
            following = pool.submit(next, items, None)
            yield item
