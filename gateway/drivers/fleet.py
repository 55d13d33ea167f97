"""A fleet of logs: the core of `replay` over each of them, in many processes.

Every log is a task of its own that leaves one file, and the file says what it rests on; nothing
else is remembered. Whatever is killed loses the logs it was at, and they are done again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from dbc.codec import Codec, bind
from dbc.frame import Frame
from gateway.core import Gateway
from gateway.drivers.fleet_logs import (
    FOLDER,
    Job,
    Settings,
    done_before,
    fingerprint,
    job,
    remove_parts,
    shown,
)
from gateway.drivers.replay import BadLogError, OneChannel, open_log, replay
from gateway.outbox import GatewayView
from gateway.results.fleet_log import Estimates
from gateway.results.fleet_table import BAD, Row, per_drive
from gateway.results.record import Recorder

Work = Callable[[Job, Settings], Row]
ERROR_LENGTH = 500


class Plan(NamedTuple):
    """The jobs in the order of the logs, the rows of those done before, and the others."""

    jobs: list[Job]
    before: dict[Job, Row]
    todo: list[Job]


def plan(paths: Sequence[Path], settings: Settings, *, force: bool) -> Plan:
    """Which logs are to be done; `force`: all of them. Makes the folder. Raises OSError."""
    (settings.folder / FOLDER).mkdir(parents=True, exist_ok=True)
    jobs = [job(path) for path in paths]
    rows = {} if force else {one: done_before(one, settings) for one in jobs}
    before = {one: row for one, row in rows.items() if row is not None}
    return Plan(jobs, before, [one for one in jobs if one not in before])


def one_log(one: Job, settings: Settings) -> Row:
    """Replay a log, leave its file, give its row; a log that cannot be done is a bad row.

    Never raises on a log, whatever it is: there are others to be done.
    """
    began = time.perf_counter()
    try:
        row = _replayed(one, settings, began)
    except Exception as error:  # a fault of ours in one log must not stop the others either
        (settings.folder / FOLDER / one.name).unlink(missing_ok=True)
        row = bad(one, error, time.perf_counter() - began)
    return row


def bad(one: Job, error: BaseException | str, took_s: float | None = None) -> Row:
    """The row of a log that could not be done, and why."""
    text = " ".join(str(error).split())
    if isinstance(error, BaseException) and type(error).__name__ not in ("BadLogError", "LogError"):
        text = f"{type(error).__name__}: {text}"
    size = one.path.stat().st_size if one.path.is_file() else None
    return Row(
        shown(one.path), BAD, text[:ERROR_LENGTH], size_bytes=size,
        took_s=None if took_s is None else round(took_s, 3),
    )  # fmt: skip


@lru_cache(maxsize=4)
def _codec(path: Path, nodes: tuple[int, ...]) -> Codec:
    return bind(path, nodes)


def _replayed(one: Job, settings: Settings, began: float) -> Row:
    if one.path.exists() and not one.path.is_file():
        msg = f"{shown(one.path)}: not a file"
        raise BadLogError(msg)
    config = settings.config
    log = open_log(one.path, strict=False)
    mark = fingerprint(one.path, settings)
    codec = _codec(config.dbc_path, config.nodes)
    blocks = OneChannel(log.blocks, settings.log_channel)
    recorder = Recorder(None, config.nodes, series=False)
    ended_ns = 0
    with Estimates(settings.folder / FOLDER / one.name, config.nodes) as estimates:

        def sink(now: int, _out: list[Frame], view: GatewayView) -> None:
            nonlocal ended_ns
            ended_ns = now
            recorder.add(view)
            estimates.add(view)

        done = replay(blocks, lambda at: Gateway(config, codec, at), config.loop.period_ns, sink)
        reader = log.reader
        faults = sum(n for verdict, n in reader.counts.items() if verdict.is_fault) if reader else 0
        row = Row(
            path=shown(one.path), warning=(reader.truncated or None) if reader else None,
            file=f"{FOLDER}/{one.name}", size_bytes=int(mark["size_bytes"]),
            channel=done.channel.encode("utf-8", "surrogateescape").decode("utf-8", "replace"),
            first_ns=done.first_ns, last_ns=done.last_ns, frames=done.frames,
            faulty_lines=faults, counts=dict(done.gateway.inbox.counts),
            drives=per_drive(recorder.changes, config.nodes, ended_ns),
            took_s=round(time.perf_counter() - began, 3),
        )  # fmt: skip
        said = {"path": row.path, "config": config.model_dump_json(), "row": row.to_json()}
        estimates.finish({**said, **mark})
    return row


def run(
    planned: Plan,
    settings: Settings,
    jobs: int,
    scheduler: str | None,
    after: Callable[[Job, Row], None],
    work: Work = one_log,
) -> None:
    """Do what is to be done; `after` hears of every log as it ends, in any order.

    jobs: local processes, unless `scheduler` names where to send the work. Raises OSError where
    no scheduler answers or it goes away; what has ended by then stays done.
    """
    if not planned.todo:
        return
    from gateway.drivers.fleet_dask import send

    try:
        send(planned.todo, settings, jobs, scheduler, work, after)
    finally:
        remove_parts(planned.todo, settings.folder)
