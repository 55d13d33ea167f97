"""Work that another thread does ahead: reading goes on while what was read is looked at."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import TypeVar

T = TypeVar("T")


def ahead(items: Iterator[T]) -> Iterator[T]:
    """The same items (none of them None), the next one made while the last is looked at.

    What making one raises is raised in its place. Pays where making them leaves Python to others,
    as compiled loops and zlib do.
    """
    wanted: SimpleQueue[bool] = SimpleQueue()
    made: SimpleQueue[T | BaseException | None] = SimpleQueue()

    def prefetch() -> None:
        while wanted.get():
            try:
                made.put(next(items, None))
            except BaseException as error:  # raised where the item is asked for
                made.put(error)

    worker = threading.Thread(target=prefetch, name="ahead", daemon=True)
    worker.start()
    wanted.put(True)
    try:
        while (item := made.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            wanted.put(True)
            yield item
    finally:
        wanted.put(False)
        worker.join()
