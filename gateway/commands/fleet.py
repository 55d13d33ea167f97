"""`fleet`: replay many logs in many processes, with the results in Parquet."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dbc.text import printable
from gateway.commands.common import FAILED, GOOD, add_config, number_of_jobs
from gateway.commands.progress import Progress
from gateway.io.console import console
from gateway.io.extras import need

if TYPE_CHECKING:
    from gateway.fleet.logs import Job
    from gateway.fleet.table import Row

BAD_SHOWN = 20


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", nargs="+", metavar="PATTERN",
                        help="files, folders (recursive), patterns: 'logs/**/*.log', or URLs of "
                        "them: 's3://bucket/logs/**/*.log'")  # fmt: skip
    add_config(parser)
    parser.add_argument("-o", "--output", required=True, metavar="DIR",
                        help="folder or URL for fleet.parquet, fleet.csv and estimates/, a file "
                        "per log")  # fmt: skip
    parser.add_argument("-j", "--jobs", type=number_of_jobs, metavar="N",
                        default=os.cpu_count() or 1,
                        help="local processes (default: one per CPU)")  # fmt: skip
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="Dask scheduler instead, tls://HOST:PORT")  # fmt: skip
    parser.add_argument("--partition", type=_parts, default=(), metavar="KEYS",
                        help="folders by these keys: day,train makes "
                        "estimates/day=2026-11-28/train=NAME/")  # fmt: skip
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if logs have several")
    parser.add_argument("--force", action="store_true", help="also replay logs that are done")


def _parts(text: str) -> tuple[str, ...]:
    parts = tuple(text.split(","))
    if not set(parts) <= {"day", "train"} or len(set(parts)) < len(parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not day,train or one of the two")
    return parts


def run(options: argparse.Namespace) -> int:
    """Replay the logs, write the tables, print a summary.

    Exit 1 if any log is bad, or if more than 1 % of a log was dropped.
    """
    need(("distributed", "pyarrow"), "fleet")
    from gateway.fleet import run as fleet
    from gateway.fleet import storage
    from gateway.fleet.logs import find, settings_for
    from gateway.fleet.table import BAD, write_table
    from gateway.settings.config import load

    output = storage.place(options.output)
    paths = find(options.log, output)
    config = load(options.config)
    settings = settings_for(config, options.log_channel, output, options.partition)
    planned = fleet.plan(paths, settings, force=options.force)
    rows = dict(planned.before)

    def finish() -> list[Row]:
        table = [rows[one] for one in planned.jobs if one in rows]
        metadata = {"settings": settings.key, "version": settings.version}
        metadata["config"] = config.model_dump_json()
        with storage.writable(settings.folder) as folder:
            names = [path.name for path in write_table(folder, table, metadata)]
        files = [settings.folder / name for name in names]
        _summary(table, len(planned.before), len(planned.jobs), files)
        return table

    try:
        with _progress(planned.jobs, planned.before) as shown:

            def after(one: Job, row: Row) -> None:
                rows[one] = row
                shown(one, row)

            fleet.run(planned, settings, options.jobs, options.scheduler, after)
    except KeyboardInterrupt:
        finish()
        console().print("stopped; run the same command again to continue")
        raise
    except OSError:
        if len(rows) > len(planned.before):
            finish()
        raise
    table = finish()
    return FAILED if any(row.status == BAD or row.dropped for row in table) else GOOD


def _summary(rows: Sequence[Row], before: int, logs: int, files: Sequence[Path]) -> None:
    """Print a summary of the results."""
    from gateway.fleet.table import BAD

    bad = [row for row in rows if row.status == BAD]
    left = logs - len(rows)
    parts = [f"{len(rows) - len(bad) - before} done", f"{before} done before", f"{len(bad)} bad"]
    print(f"{logs} logs: " + ", ".join(parts + ([f"{left} left"] if left else [])))
    hours = sum(row.duration_s or 0.0 for row in rows) / 3600.0
    losses = sum(row.total("adhesion_losses") for row in rows)
    faults = sum(row.total("thermal_faults") for row in rows)
    print(f"{hours:.3f} h of logs: {losses} adhesion losses, {faults} thermal faults")
    for row in bad[:BAD_SHOWN]:
        print(bad_line(row))
    if len(bad) > BAD_SHOWN:
        print(f"bad: {len(bad) - BAD_SHOWN} more, see {files[1]}")
    warned = [row for row in rows if row.warning]
    for row in warned[:BAD_SHOWN]:
        console().print(f"warning: {row.path}: {row.warning}", markup=False, soft_wrap=True)
    if len(warned) > BAD_SHOWN:
        console().print(f"warning: {len(warned) - BAD_SHOWN} more logs, see {files[1]}")
    print(f"written: {', '.join(str(path) for path in files)}")


def bad_line(row: Row) -> str:
    """Why a log was left out; control characters in its name cannot reach the terminal."""
    return printable(f"bad: {row.path}: {row.error}")


@contextmanager
def _progress(jobs: Sequence[Job], before: dict[Job, Row]) -> Iterator[Callable[[Job, Row], None]]:
    """Yield a callback for finished logs: a bar over the bytes, and a line for each bad log."""
    from gateway.fleet import storage
    from gateway.fleet.table import BAD

    def size(one: Job) -> int:
        return one.path.stat().st_size if one.path.is_file() else 0

    slow = any(storage.remote(one.path) is not None for one in jobs)
    sizes = dict(zip(jobs, storage.each(size, jobs, slow=slow), strict=True))
    ended = len(before)
    done = sum(sizes[one] for one in before)
    with Progress(f"{ended}/{len(jobs)} logs", sum(sizes.values()), done) as progress:

        def after(one: Job, row: Row) -> None:
            nonlocal ended
            ended += 1
            progress.advance(sizes[one], f"{ended}/{len(jobs)} logs")
            if row.status == BAD:
                progress.print(bad_line(row))

        yield after
