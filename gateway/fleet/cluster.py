"""Runs the logs of a fleet on Dask: local processes, or an existing scheduler.

Whoever can connect to a scheduler can run code as its user. Local processes use TLS with a
certificate made for this run and kept in memory; a named scheduler is reached as Dask's own
configuration says.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from typing import Final

import dask
from distributed import Client, LocalCluster, Security, as_completed
from distributed.core import Status
from distributed.deploy.spec import close_clusters
from distributed.scheduler import KilledWorker

from gateway.fleet.logs import Job, Settings, done_before
from gateway.fleet.table import Row
from gateway.fleet.task import Work, bad, ready
from gateway.settings.config import ConfigError

ALLOWED_DEATHS: Final = 1
"""Workers that may die at a log before it is suspected and tried again alone."""
RETRIES: Final = 2
"""Retries of a task that raises: ours return a bad row, so it was Dask that failed."""
DIED: Final = "every worker that tried this log died"
STARTS: Final = 6
"""Attempts to start the local processes."""
CHECK_S: Final = 1.0
"""Time between two checks whether all local processes are running."""
ALONE: Final = 2
"""Times that a suspected log is tried alone, as something else may have killed the workers."""
SECURE: Final = ("tls://", "wss://", "inproc://")
CERTIFICATE: Final = (
    "needs certificates: name them in Dask's configuration, `distributed.comm.tls.ca-file` and "
    "`distributed.comm.tls.client.cert`, `.key` (variables DASK_DISTRIBUTED__COMM__TLS__CA_FILE ..)"
)
PATIENCE_S: Final = 30
"""Longest time, each, to connect to a scheduler and to wait for a worker."""
_THREADS: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_LOCAL: Final = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(_THREADS, 1),
    "distributed.deploy.lost-worker-timeout": "365 days",
}
"""Local processes: one thread each, no status pages, no sampling of the stack.

A process that has been missing for 15 s (Dask's default) is not given up either: it may have been
restarted and have died once more.
"""

log = logging.getLogger(__name__)
After = Callable[[Job, Row], None]


def _local(jobs: int, level: int) -> LocalCluster:
    """Start local processes, again if one is killed while it starts. Raises OSError in the end."""
    for left in reversed(range(STARTS)):
        try:
            # No memory limit: a replay's memory does not grow with its log.
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
    """While the cluster runs, restart local processes that Dask has given up.

    Dask restarts a process that has died, but gives it up if the restart fails. Without any process
    the remaining logs would wait for ever.
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

    Raises ConfigError for an address or certificate that cannot be used, OSError if no scheduler or
    worker answers.
    """
    # The fleet reports the result of each log itself; `-v` shows Dask's own messages.
    level = logging.INFO if log.isEnabledFor(logging.INFO) else logging.CRITICAL
    for name in ("distributed", "distributed.client", "asyncio"):
        logging.getLogger(name).setLevel(level)
    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(_LOCAL))
            try:
                cluster = stack.enter_context(_local(jobs, level))
                cluster.loop.add_callback(_keep, cluster, jobs)
                yield stack.enter_context(Client(cluster))
            except KeyboardInterrupt:
                # At exit, Dask would fail with a traceback to close processes that are starting.
                # They end with this one.
                atexit.unregister(close_clusters)
                raise
            return
        if not scheduler.startswith(SECURE):
            log.warning("%s: not encrypted; whoever reaches it can run code there", scheduler)
        if scheduler.startswith("tls://") and not _has_certificate():
            # A `Client` whose construction fails waits for itself for ever when it is collected.
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
    """Whether Dask's configuration names a certificate. Raises OSError for unusable files."""
    return Security().get_connection_args("client").get("ssl_context") is not None


def send(
    todo: Sequence[Job], settings: Settings, jobs: int, scheduler: str | None, work: Work,
    after: After,
) -> None:  # fmt: skip
    """Run all of `todo`, one task per log; see `gateway.fleet.run.run`.

    A worker takes one log at a time, so that its death affects no other log. Logs at which workers
    kept dying are tried again, one by one, after all others; a log at which workers also die in
    these `ALONE` turns gets a bad row.
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
                # A row is lost with the worker that holds it, although the file may be written.
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
    """Whether an error comes from an interrupt, also one while Dask starts or ends."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def _prepare(client: Client, settings: Settings) -> None:
    """Prepare all workers at once. Raises ConfigError with the problems of any of them."""
    # A worker that dies meanwhile gives an error; its successor is prepared by its first log.
    results: dict[str, object] = client.run(ready, settings, on_error="return")
    problems = [text for text in results.values() if isinstance(text, str) and text]
    if problems:
        raise ConfigError("fleet", list(dict.fromkeys(problems)))


def _flow(
    client: Client, todo: Sequence[Job], settings: Settings, work: Work, turn: int,
    ended: Callable[[Job, Row | BaseException], None],
) -> None:  # fmt: skip
    """Run as many tasks at once as there are threads, in a later `turn` one, until all ended."""
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
            msg = "scheduler lost; finished logs are kept, run the same command again to continue"
            raise OSError(msg) from None
        except Exception as error:  # our tasks return a bad row, so this error is Dask's
            outcome = error
        task.release()
        ended(one, outcome)
        fill()
