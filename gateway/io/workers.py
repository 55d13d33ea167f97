"""Local processes for independent tasks; all of them end with this one."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context


@contextmanager
def workers(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes. After an exception or a signal they are ended, not waited for."""
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


def _leave_it_to_the_parent() -> None:
    """Ctrl-C in a terminal is for all of its processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
