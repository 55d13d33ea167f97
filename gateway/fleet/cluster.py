"""Runs the logs of a fleet on Dask: local processes, or an existing scheduler.

Who reaches a scheduler runs code as its user. Local ones speak TLS with a certificate that is made
for this run and kept in memory; a named one is reached as Dask's own configuration says.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from typing import Final

import dask
from distributed import Client, LocalCluster, Security, as_completed
from distributed.core import Status
from distributed.scheduler import KilledWorker

from gateway.fleet.logs import Job, Settings, done_before
from gateway.fleet.table import Row
from gateway.fleet.task import Work, bad, ready
from gateway.settings.config import ConfigError

ALLOWED_DEATHS: Final = 1
"""Workers that may die at a log before it is suspected; then it gets its turn alone."""
RETRIES: Final = 2
"""Of a task that raises: ours give a bad row, so it was Dask that failed."""
DIED: Final = "every worker that tried this log died"
STARTS: Final = 6
"""Times that local processes are started, if they do not come up."""
CHECK_S: Final = 1.0
"""Between two looks whether all local processes are there."""
ALONE: Final = 2
"""Times that a suspected log gets its turn alone: what kills workers may have been something else.
"""
SECURE: Final = ("tls://", "wss://", "inproc://")
CERTIFICATE: Final = (
    "needs certificates: name them in Dask's configuration, `distributed.comm.tls.ca-file` and "
    "`distributed.comm.tls.client.cert`, `.key` (variables DASK_DISTRIBUTED__COMM__TLS__CA_FILE ..)"
)
PATIENCE_S: Final = 30
"""To reach a scheduler and see a worker of it."""
_THREADS: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_LOCAL: Final = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(_THREADS, 1),
    "distributed.deploy.lost-worker-timeout": "365 days",
}
"""For local processes: one thread each, no pages to look at, nobody who samples the stack.

Nor is one given up that is not there 15 s (Dask's default) after it died: it may have started
again and died once more.
"""

log = logging.getLogger(__name__)
After = Callable[[Job, Row], None]


def _local(jobs: int, level: int) -> LocalCluster:
    """Local processes. One that is killed while it starts is no reason to give up."""
    for left in reversed(range(STARTS)):
        try:
            # No limit of memory: a replay's does not grow with its log.
            return LocalCluster(
                n_workers=jobs, threads_per_worker=1, processes=True, memory_limit=None,
                dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                silence_logs=level, host="127.0.0.1", protocol="tls://",
                security=Security.temporary(),
            )  # fmt: skip
        except (RuntimeError, OSError) as error:
            if not left:
                raise OSError(f"the local processes do not start: {error}") from error
    raise AssertionError


def _keep(cluster: LocalCluster, jobs: int) -> None:
    """As long as the cluster runs, start local processes again that Dask has given up.

    Dask starts a process that died again, but gives it up if the start fails. Without any process
    the logs that are left would wait for ever.
    """
    if cluster.status != Status.running:
        return
    for name, nanny in list(cluster.workers.items()):
        if nanny.status in (Status.closed, Status.failed):
            del cluster.workers[name]
    if len(cluster.workers) < jobs:
        cluster.scale(jobs)
    asyncio.get_running_loop().call_later(CHECK_S, _keep, cluster, jobs)


@contextmanager
def _client(jobs: int, scheduler: str | None) -> Iterator[Client]:
    """A client of local processes with a thread each, or of the named scheduler.

    Raises ConfigError for an address or certificate that cannot be used, OSError where nobody
    answers.
    """
    # What becomes of each log is said by us; `-v` shows what Dask says itself.
    level = logging.INFO if log.isEnabledFor(logging.INFO) else logging.CRITICAL
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(level)
    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(_LOCAL))
            cluster = stack.enter_context(_local(jobs, level))
            cluster.loop.add_callback(_keep, cluster, jobs)
            yield stack.enter_context(Client(cluster))
            return
        if not scheduler.startswith(SECURE):
            log.warning("%s: not encrypted; whoever reaches it can run code there", scheduler)
        if scheduler.startswith("tls://") and not _has_certificate():
            # A `Client` that fails in its making waits for itself for ever when it is collected.
            raise ConfigError("--scheduler", [f"{scheduler}: {CERTIFICATE}"])
        try:
            client = stack.enter_context(Client(scheduler, timeout=PATIENCE_S))
        except ValueError as error:
            raise ConfigError("--scheduler", [f"{scheduler!r}: {error}"]) from None
        except TypeError:  # what Dask raises without a certificate
            raise ConfigError("--scheduler", [f"{scheduler}: {CERTIFICATE}"]) from None
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            msg = f"{scheduler}: no worker within {PATIENCE_S} s"
            raise OSError(msg) from None
        yield client


def _has_certificate() -> bool:
    """Whether Dask's configuration names one. Raises OSError for files that cannot be used."""
    return Security().get_connection_args("client").get("ssl_context") is not None


def send(
    todo: Sequence[Job],
    settings: Settings,
    jobs: int,
    scheduler: str | None,
    work: Work,
    after: After,
) -> None:
    """Do all of `todo`, a task each; see `gateway.fleet.run.run`.

    A worker takes one log at a time, so that one that dies takes no other log with it. Where
    workers kept dying, the logs they were at are tried again, one by one, after all others: a log
    at which workers die `ALONE` times more is a bad one.
    """
    suspects: list[Job] = []

    def ended(one: Job, outcome: Row | BaseException) -> None:
        if isinstance(outcome, KilledWorker):
            suspects.append(one)
        else:
            after(one, bad(one, outcome) if isinstance(outcome, BaseException) else outcome)

    try:
        with _client(jobs, scheduler) as client:
            _prepare(client, settings)
            _flow(client, todo, settings, work, 0, ended)
            for turn in range(1, ALONE + 1):
                # A row is lost with the worker that has it, although the log's file may be there.
                found = {one: done_before(one, settings) for one in suspects}
                for one, row in found.items():
                    if row is not None:
                        after(one, row)
                suspects.clear()
                left = [one for one, row in found.items() if row is None]
                _flow(client, left, settings, work, turn, ended)
            for one in suspects:
                after(one, bad(one, DIED))
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
    # Of a worker that dies meanwhile there is an error: the next one gets ready at its first log.
    results: dict[str, object] = client.run(ready, settings, on_error="return")
    problems = [text for text in results.values() if isinstance(text, str) and text]
    if problems:
        raise ConfigError("fleet", list(dict.fromkeys(problems)))


def _flow(
    client: Client,
    todo: Sequence[Job],
    settings: Settings,
    work: Work,
    turn: int,
    ended: Callable[[Job, Row | BaseException], None],
) -> None:
    """Keep as many tasks going as there are threads, in a later `turn` one, until all ended."""
    waiting = deque(todo)
    going: dict[str, Job] = {}
    tasks = as_completed([])

    def fill() -> None:
        most = 1 if turn else max(1, sum(client.nthreads().values()))
        while waiting and len(going) < most:
            one = waiting.popleft()
            key = f"log-{one.name}-{turn}"
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
