"""The logs of a fleet, which of them are done, and whether a log has changed since."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import quote

from gateway.fleet import storage
from gateway.fleet.table import TABLE, TEXT, Row, metadata_of
from gateway.io.whole_file import PART
from gateway.settings.config import Config, ConfigError

FOLDER: Final = "estimates"
"""Folder of the logs' result files, in the folder for results."""
_EDGE: Final = 1 << 20
_STEM: Final = 60


class Settings(NamedTuple):
    """Settings common to all logs. key: hash of all that a result depends on, except the log.

    folder: for results, absolute, as other processes get these settings. parts: the keys of
    `file_of` that give folders between `estimates` and a log's file.
    """

    config: Config
    log_channel: str | None
    folder: Path
    key: str
    version: str
    parts: tuple[str, ...] = ()


class Job(NamedTuple):
    """One log to be replayed: its absolute path or URL, and the name of its result file."""

    path: Path
    name: str


def settings_for(
    config: Config, log_channel: str | None, folder: Path, parts: tuple[str, ...] = ()
) -> Settings:
    """Make the settings. A missing file is no error here: `gateway.fleet.task.ready` reports it."""
    digest = hashlib.sha256(config.model_dump_json().encode())
    for path in (config.dbc_path, config.calibration_path):
        digest.update(b"\0" + (path.read_bytes() if path and path.is_file() else b""))
    digest.update(b"\0" + "\0".join((log_channel or "", *parts)).encode())
    # Absolute, because the working folder of another process may be a different one.
    absolute = config.model_copy(update={"base": config.base.absolute()})
    key = digest.hexdigest()[:16]
    here = version("traction-gateway")
    return Settings(absolute, log_channel, folder.absolute(), key, here, parts)


def find(patterns: Sequence[str], folder: Path) -> list[Path]:
    """Files that match the patterns, absolute, sorted, each once; a folder means all files in it.

    `**` matches folders at any depth; hidden files and a fleet's own results in `folder` are
    skipped. A name without `*?[` that does not exist is kept, and reported later. URLs come last.
    Raises ConfigError if no file is found, OSError if a storage does not answer.
    """
    found: dict[str, Path] = {}
    urls: dict[str, Path] = {}
    for pattern in patterns:
        if storage.is_url(pattern):
            inside = storage.matches(pattern)
            urls.update({str(path): path for path in inside if not _ours(path, folder)})
            continue
        for path in _matches(pattern):
            if not _ours(path, folder.absolute()):
                found.setdefault(os.path.realpath(path), path)
    paths = sorted(found.values())
    if not urls and not any(path.exists() for path in paths):
        raise ConfigError("fleet", [f"no log matches {pattern!r}" for pattern in patterns])
    return paths + [urls[name] for name in sorted(urls)]


def _matches(pattern: str) -> list[Path]:
    literal = os.path.lexists(pattern) or not glob.has_magic(pattern)
    names = [pattern] if literal else _glob(pattern)
    if Path(pattern).name != "**":
        folders = [name for name in names if Path(name).is_dir()]
        names += [name for folder in folders for name in _glob(f"{glob.escape(folder)}/**")]
    # Links are not resolved: users know the log by the name that they gave.
    return [
        Path(os.path.abspath(name))  # noqa: PTH100
        for name in names
        if not Path(name).is_dir()
    ]


def _glob(pattern: str) -> list[str]:
    return glob.glob(pattern, recursive=True)  # noqa: PTH207 Path.glob takes no absolute pattern


def _ours(path: Path, folder: Path) -> bool:
    if path.parent == folder:
        return path.name in (TABLE, TEXT)
    return folder / FOLDER in path.parents and path.suffix in (".parquet", PART)


def job(path: Path) -> Job:
    """The job of an absolute path, with a file name that no other path has."""
    stem = re.sub(r"[^A-Za-z0-9._-]", "_", path.name.removesuffix(".gz")).rpartition(".")
    short = hashlib.sha256(os.fsencode(str(path))).hexdigest()[:10]
    return Job(path, f"{(stem[0] or stem[2])[:_STEM]}-{short}.parquet")


def shown(path: Path) -> str:
    """The path as valid UTF-8 text; bytes that are not are escaped."""
    return os.fsencode(str(path)).decode("utf-8", "backslashreplace")


def file_of(one: Job, settings: Settings, first_ns: int) -> str:
    """Path of a log's file in the results, with a folder `key=value` per `settings.parts`.

    day: UTC day of the first frame. train: name of the log's folder.
    """
    day = datetime.fromtimestamp(first_ns // 10**9, UTC).date().isoformat()
    train = shown(one.path.parent).rstrip("/").rpartition("/")[2]
    values = {"day": day, "train": quote(train, safe="") or "none"}
    return "/".join([FOLDER, *(f"{key}={values[key]}" for key in settings.parts), one.name])


def files_in(folder: Path, name: str = "*.parquet") -> dict[str, list[Path]]:
    """The finished files below `estimates`, by name, in whatever partition."""
    found: dict[str, list[Path]] = {}
    for path in sorted((storage.fresh(folder) / FOLDER).rglob(name), key=str):
        if not path.name.startswith("."):
            found.setdefault(path.name, []).append(path)
    return found


def fingerprint(path: Path, settings: Settings) -> dict[str, str]:
    """What a result depends on: the log's size, time and ends, and the settings. Raises OSError.

    For a log by URL, the hash that its storage keeps (ETag) replaces the hash of the ends.
    """
    rest = {"settings": settings.key, "version": settings.version}
    if storage.remote(path) is not None:
        return storage.state(path) | rest
    with path.open("rb") as file:
        state = os.fstat(file.fileno())
        ends = hashlib.sha256(file.read(_EDGE))
        file.seek(max(0, state.st_size - _EDGE))
        ends.update(file.read(_EDGE))
    mark = {"size_bytes": str(state.st_size), "mtime_ns": str(state.st_mtime_ns)}
    return {**mark, "sha256_of_ends": ends.hexdigest(), **rest}


def done_before(one: Job, settings: Settings, places: Sequence[Path] | None = None) -> Row | None:
    """The row of a log that is done and has not changed since, else None.

    places: its result files, if they are known.
    """
    places = _places(one, settings) if places is None else places
    if len(places) != 1:
        return None
    metadata = metadata_of(places[0])
    try:
        same = bool(metadata) and fingerprint(one.path, settings).items() <= metadata.items()
        return Row.of_json(metadata["row"]) if same else None
    except (OSError, KeyError, ValueError, TypeError):
        return None


def remove_files(one: Job, settings: Settings) -> None:
    """Remove a log's result files, in whatever partition."""
    for path in _places(one, settings):
        path.unlink(missing_ok=True)


def _places(one: Job, settings: Settings) -> list[Path]:
    """Paths at which the log's result file may be."""
    if not settings.parts:
        return [storage.fresh(settings.folder) / FOLDER / one.name]
    return files_in(settings.folder, one.name).get(one.name, [])


def remove_parts(jobs: Iterable[Job], folder: Path) -> None:
    """Remove unfinished files of these logs that killed workers have left."""
    names = {one.name for one in jobs}
    if storage.remote(folder) is not None:
        return
    for part in (folder / FOLDER).rglob(f".*{PART}"):
        if part.name[1:].rsplit(".", 2)[0] in names:
            part.unlink(missing_ok=True)
