"""Sending the logs of a fleet to Dask: local processes, or a scheduler that is there already."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from typing import Final

import dask
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from gateway.config import ConfigError
from gateway.drivers.fleet_logs import Job, Settings, done_before
from gateway.drivers.fleet_task import Work, bad, ready
from gateway.results.fleet_table import Row

ALLOWED_DEATHS: Final = 1
"""Workers that may die at a log before it is suspected; then it gets its turn alone."""
RETRIES: Final = 2
"""Of a task that raises: ours give a bad row, so it was Dask that failed."""
DIED: Final = "every worker that tried this log died"
PATIENCE_S: Final = 30
"""To reach a scheduler and see a worker of it."""
_THREADS: Final = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip
_LOCAL: Final = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(_THREADS, 1),
}
"""For local processes: one thread each, no pages to look at, nobody who samples the stack."""

log = logging.getLogger(__name__)
After = Callable[[Job, Row], None]


@contextmanager
def _client(jobs: int, scheduler: str | None) -> Iterator[Client]:
    """A client of local processes with a thread each, or of the named scheduler."""
    # What becomes of each log is said by us; `-v` shows what Dask says itself.
    level = logging.INFO if log.isEnabledFor(logging.INFO) else logging.CRITICAL
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(level)
    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(_LOCAL))
            # No limit of memory: a replay's does not grow with its log.
            cluster = LocalCluster(
                n_workers=jobs, threads_per_worker=1, processes=True, memory_limit=None,
                dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                silence_logs=level,
            )  # fmt: skip
            yield stack.enter_context(Client(stack.enter_context(cluster)))
            return
        try:
            client = stack.enter_context(Client(scheduler, timeout=PATIENCE_S))
        except ValueError as error:
            raise ConfigError("--scheduler", [f"{scheduler!r}: {error}"]) from None
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            msg = f"{scheduler}: no worker within {PATIENCE_S} s"
            raise OSError(msg) from None
        yield client


def send(
    todo: Sequence[Job],
    settings: Settings,
    jobs: int,
    scheduler: str | None,
    work: Work,
    after: After,
) -> None:
    """Do all of `todo`, a task each; see `gateway.drivers.fleet.run`.

    A worker takes one log at a time, so that one that dies takes no other log with it. Where
    workers kept dying, the logs they were at are tried once more, one by one, after all others: a
    log whose worker dies then is a bad one.
    """
    suspects: list[Job] = []

    def ended(one: Job, outcome: Row | BaseException) -> None:
        if isinstance(outcome, KilledWorker):
            suspects.append(one)
        else:
            after(one, bad(one, outcome) if isinstance(outcome, BaseException) else outcome)

    def ended_alone(one: Job, outcome: Row | BaseException) -> None:
        if isinstance(outcome, KilledWorker):
            after(one, bad(one, DIED))
        else:
            ended(one, outcome)

    try:
        with _client(jobs, scheduler) as client:
            _prepare(client, settings)
            _flow(client, todo, settings, work, None, ended)
            # A row is lost with the worker that has it, although the log's file may be there.
            found = {one: done_before(one, settings) for one in suspects}
            for one, row in found.items():
                if row is not None:
                    after(one, row)
            left = [one for one, row in found.items() if row is None]
            _flow(client, left, settings, work, 1, ended_alone)
    except Exception as error:
        if _interrupted(error):
            raise KeyboardInterrupt from None
        raise


def _interrupted(error: BaseException | None) -> bool:
    """True for what Dask says when it is interrupted while it starts or ends."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def _prepare(client: Client, settings: Settings) -> None:
    """Get all workers ready at once; ConfigError with what is wrong with any of them."""
    said: dict[str, str] = client.run(ready, settings)
    problems = [text for text in said.values() if text]
    if problems:
        raise ConfigError("fleet", list(dict.fromkeys(problems)))


def _flow(
    client: Client,
    todo: Sequence[Job],
    settings: Settings,
    work: Work,
    width: int | None,
    ended: Callable[[Job, Row | BaseException], None],
) -> None:
    """Keep `width` tasks going (None: as many as there are threads) until all have ended."""
    waiting = deque(todo)
    going: dict[str, Job] = {}
    tasks = as_completed([])

    def fill() -> None:
        most = width or max(1, sum(client.nthreads().values()))
        while waiting and len(going) < most:
            one = waiting.popleft()
            key = f"log-{one.name}-{width}"
            going[key] = one
            tasks.add(client.submit(work, one, settings, key=key, pure=False, retries=RETRIES))

    fill()
    for task in tasks:
        one = going.pop(task.key)
        outcome: Row | BaseException
        try:
            outcome = task.result()
        except CancelledError:
            msg = "the scheduler is gone; what is finished stays, run again to go on"
            raise OSError(msg) from None
        except Exception as error:  # ours give a bad row: whatever is raised is Dask's
            outcome = error
        task.release()
        ended(one, outcome)
        fill()
