"""The work for one log of a fleet: replay, result file, row."""

from __future__ import annotations

import time
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from dbc.candump.grammar import Verdict
from dbc.codec import Codec, bind
from dbc.text import InputError
from gateway.core.gateway import Gateway
from gateway.fleet import storage
from gateway.fleet.log_result import Estimates
from gateway.fleet.logs import FOLDER, Job, Settings, file_of, fingerprint, shown
from gateway.fleet.table import Row, per_drive
from gateway.io.log_file import BadLogError, OneChannel, open_log
from gateway.io.replay import Briefly, replay
from gateway.reports.record import Changes


@lru_cache(maxsize=4)
def _codec(path: Path, nodes: tuple[int, ...]) -> Codec:
    return bind(path, nodes)


def prepare(settings: Settings) -> str:
    """Load what a replay needs; return the problem, empty if there is none.

    It is a text, because an exception might not be transferable to another process.
    """
    config, here = settings.config, version("traction-gateway")
    if settings.version != here:
        problem = f"a worker has traction-gateway {here}, not {settings.version}"
        return f"{problem}; install the same version on all workers"
    try:
        Gateway(config, _codec(config.dbc_path, config.nodes), 0)
    except (InputError, OSError) as error:
        return " ".join(str(error).split())
    return ""


def replayed(one: Job, settings: Settings, began: float) -> Row:
    """Replay a log, write its file, return its row. Raises any error that the log causes.

    began: value of `time.perf_counter` from which the row's time counts.
    """
    if not one.path.is_file():
        msg = "not a file" if one.path.exists() else "no such file"
        raise BadLogError(msg)
    # Taken before the log is read: if it is still being written, the next run sees a change.
    mark = fingerprint(one.path, settings)
    with storage.fetched(one.path) as log, storage.writable(settings.folder) as folder:
        return _replayed(one, settings, log, folder, mark)._replace(
            took_s=round(time.perf_counter() - began, 3)
        )


def _replayed(one: Job, settings: Settings, path: Path, folder: Path, mark: dict[str, str]) -> Row:
    """Replay `path` and write the file into `folder`, both local. The row has no `took_s`.

    Nor has the file, so that the same log always gives the same bytes.
    """
    config = settings.config
    log = open_log(path, strict=False)
    codec = _codec(config.dbc_path, config.nodes)
    blocks = OneChannel(log.blocks, settings.log_channel)
    recorder = Changes()
    (folder / FOLDER).mkdir(exist_ok=True)
    with Estimates(folder / FOLDER / one.name, config.nodes) as estimates:
        sink = Briefly(lambda _out: None, recorder.follow, estimates)
        done = replay(blocks, lambda at: Gateway(config, codec, at), config.loop.period_ns, sink)
        reader = log.reader
        faulty = sum(n for v, n in reader.counts.items() if v.is_fault)
        cut = reader.truncated or (
            "its last line is incomplete" if reader.counts[Verdict.CUT] else None
        )
        row = Row(
            path=shown(one.path), warning=cut,
            file=file_of(one, settings, done.first_ns), size_bytes=int(mark["size_bytes"]),
            channel=done.channel.encode("utf-8", "surrogateescape").decode("utf-8", "replace"),
            first_ns=done.first_ns, last_ns=done.last_ns, frames=done.frames,
            faulty_lines=faulty,
            counts=dict(done.gateway.inbox.counts),
            drives=per_drive(recorder.changes, config.nodes, estimates.last_ns),
        )  # fmt: skip
        row = row._replace(warning="; ".join(filter(None, (row.warning, row.dropped))) or None)
        metadata = {"path": row.path, "config": config.model_dump_json(), "row": row.to_json()}
        assert row.file is not None
        estimates.finish(folder / row.file, {**metadata, **mark})
    return row
