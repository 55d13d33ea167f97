"""A fleet of logs: the core of `replay` over each of them, in many processes.

Every log is a task of its own that leaves one file, and the file says what it rests on; nothing
else is remembered. Whatever is killed loses the logs it was at, and they are done again.
What computes is imported in the workers only: the others need not wait for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.drivers.fleet_logs import (
    FOLDER,
    Job,
    Settings,
    done_before,
    job,
    remove_parts,
    shown,
)
from gateway.results.fleet_table import BAD, Row

Work = Callable[[Job, Settings], Row]
ERROR_LENGTH = 500


class Plan(NamedTuple):
    """The jobs in the order of the logs, the rows of those done before, and the others."""

    jobs: list[Job]
    before: dict[Job, Row]
    todo: list[Job]


def plan(paths: Sequence[Path], settings: Settings, *, force: bool) -> Plan:
    """Which logs are to be done; `force`: all of them, what they have left is taken away.

    Makes the folder. Raises OSError.
    """
    (settings.folder / FOLDER).mkdir(parents=True, exist_ok=True)
    jobs = [job(path) for path in paths]
    if force:
        for one in jobs:
            (settings.folder / FOLDER / one.name).unlink(missing_ok=True)
    rows = {one: done_before(one, settings) for one in jobs}
    before = {one: row for one, row in rows.items() if row is not None}
    return Plan(jobs, before, [one for one in jobs if one not in before])


def ready(settings: Settings) -> str:
    """Make this process ready to work; says what is wrong with the settings, or nothing."""
    from gateway.drivers.fleet_work import prepare

    return prepare(settings)


def one_log(one: Job, settings: Settings) -> Row:
    """Replay a log, leave its file, give its row; a log that cannot be done is a bad row.

    Never raises on a log, whatever it is: there are others to be done.
    """
    from gateway.drivers.fleet_work import replayed

    began = time.perf_counter()
    try:
        return replayed(one, settings, began)
    except Exception as error:  # a fault of ours in one log must not stop the others either
        # What an earlier state of the log has left would be taken for this one's.
        (settings.folder / FOLDER / one.name).unlink(missing_ok=True)
        return bad(one, error, time.perf_counter() - began)


def bad(one: Job, error: BaseException | str, took_s: float | None = None) -> Row:
    """The row of a log that could not be done, and why."""
    text = " ".join(str(error).split()).removeprefix(f"{one.path}: ")
    if isinstance(error, BaseException) and type(error).__name__ not in ("BadLogError", "LogError"):
        text = f"{type(error).__name__}: {text}"
    size = one.path.stat().st_size if one.path.is_file() else None
    return Row(
        shown(one.path), BAD, text[:ERROR_LENGTH], size_bytes=size,
        took_s=None if took_s is None else round(took_s, 3),
    )  # fmt: skip


def run(
    planned: Plan,
    settings: Settings,
    jobs: int,
    scheduler: str | None,
    after: Callable[[Job, Row], None],
    work: Work = one_log,
) -> None:
    """Do what is to be done; `after` hears of every log as it ends, in any order.

    jobs: local processes, unless `scheduler` names where to send the work. Raises ConfigError where
    a worker cannot work with the settings, OSError where no scheduler answers or it goes away; what
    has ended by then stays done.
    """
    if not planned.todo:
        return
    from gateway.drivers.fleet_dask import send

    try:
        send(planned.todo, settings, jobs, scheduler, work, after)
    finally:
        remove_parts(planned.todo, settings.folder)
