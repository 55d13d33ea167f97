"""Work that another thread does ahead: it reads on while the caller uses what was read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")


def ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield the same items (none may be None); the next is made while the caller uses the last.

    An exception raised in making an item is raised in its place. This saves time only if making an
    item releases the GIL, as compiled loops and zlib do.
    """
    # Imported here, because a live gateway starts without it.
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        following = pool.submit(next, items, None)
        while (item := following.result()) is not None:
            following = pool.submit(next, items, None)
            yield item
