"""A fleet of logs: the core of `replay` over each of them, in many processes.

Every log is a task of its own that leaves one file, and the file says what it rests on; nothing
else is remembered. Whatever is killed loses the logs it was at, and they are done again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.fleet import storage
from gateway.fleet.logs import (
    FOLDER,
    Job,
    Settings,
    done_before,
    files_in,
    job,
    remove_parts,
)
from gateway.fleet.table import Row
from gateway.fleet.task import Work, one_log


class Plan(NamedTuple):
    """The jobs in the order of the logs, the rows of those done before, and the others."""

    jobs: list[Job]
    before: dict[Job, Row]
    todo: list[Job]


def plan(paths: Sequence[Path], settings: Settings, *, force: bool) -> Plan:
    """Which logs are to be done; `force`: all of them, what they have left is taken away.

    Makes the folder. Raises OSError.
    """
    far = storage.remote(settings.folder) is not None
    if not far:
        (settings.folder / FOLDER).mkdir(parents=True, exist_ok=True)
    files = files_in(settings.folder)
    jobs = [job(path) for path in paths]

    def look(one: Job) -> Row | None:
        """A log that is done again may come to another place: its first frame has another day."""
        places = files.get(one.name, [])
        row = None if force else done_before(one, settings, places)
        for path in places if row is None else ():
            if force or settings.parts or path.parent != settings.folder / FOLDER:
                path.unlink(missing_ok=True)
        return row

    slow = far or any(storage.remote(path) is not None for path in paths)
    rows = dict(zip(jobs, storage.each(look, jobs, slow=slow), strict=True))
    before = {one: row for one, row in rows.items() if row is not None}
    return Plan(jobs, before, [one for one in jobs if one not in before])


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
    from gateway.fleet.cluster import send

    try:
        send(planned.todo, settings, jobs, scheduler, work, after)
    finally:
        remove_parts(planned.todo, settings.folder)
