"""Local worker processes for independent tasks; all of them end with this process."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


@contextmanager
def workers(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of `jobs` processes. After an exception or a signal they are ended, not awaited."""
    others = set(active_children())
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_leave_it_to_the_parent)
    with pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(active_children()) - others:
                process.terminate()
            raise


def mapped(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """Yield the function's result for each item, in order, computed in `jobs` processes."""
    if jobs <= 1:
        yield from map(function, items)
        return
    with workers(jobs) as pool:
        yield from pool.map(function, items)


def _leave_it_to_the_parent() -> None:
    """Ignore SIGINT: Ctrl-C in a terminal goes to every process, and the parent ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
