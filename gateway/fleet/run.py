"""A fleet of logs: the core of `replay` runs over each of them, in many processes.

Every log is a task of its own that writes one file, which records what its contents depend on; no
other state is kept. A killed process loses the logs it was working on, and they are done again.
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
    """Find the logs to be done; `force`: all of them, and their result files are removed.

    Makes the folder for results. Raises OSError.
    """
    far = storage.remote(settings.folder) is not None
    if not far:
        (settings.folder / FOLDER).mkdir(parents=True, exist_ok=True)
    files = files_in(settings.folder)
    jobs = [job(path) for path in paths]

    def look(one: Job) -> Row | None:
        """The row, if done; else remove files that a new run may put in another partition.

        The partition changes if the first frame now has another day.
        """
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
    planned: Plan, settings: Settings, jobs: int, scheduler: str | None,
    after: Callable[[Job, Row], None], work: Work = one_log,
) -> None:  # fmt: skip
    """Run the jobs to be done; `after` is called with every log as it ends, in any order.

    jobs: number of local processes, unless `scheduler` gives an address. Raises ConfigError if a
    worker cannot use the settings, OSError if no scheduler answers or it goes away; logs that have
    ended by then stay done.
    """
    if not planned.todo:
        return
    from gateway.fleet.cluster import send

    try:
        send(planned.todo, settings, jobs, scheduler, work, after)
    finally:
        remove_parts(planned.todo, settings.folder)
