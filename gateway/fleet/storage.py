"""Logs and results by URL (`s3://bucket/logs`) beside local paths: any storage of fsspec.

A URL becomes a `UPath`, which has a `Path`'s methods. It is imported for names with "://" only.
"""

from __future__ import annotations

import glob
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from gateway.io.extras import need
from gateway.settings.config import ConfigError

THREADS: Final = 16
_SIGN: Final = "://"
T = TypeVar("T")
R = TypeVar("R")


def is_url(name: str) -> bool:
    """Whether a name is a URL such as `s3://..`."""
    return _SIGN in name


def place(name: str) -> Path:
    """A path, or a URL with a path's methods. Raises ConfigError if it needs a missing library."""
    if not is_url(name):
        return Path(name)
    need(("upath", "s3fs") if name.startswith("s3:") else ("upath",), "s3", name)
    from upath import UPath

    try:
        return cast("Path", UPath(name))
    except (ValueError, ImportError) as error:
        raise ConfigError(name, [str(error)]) from None


def remote(path: Path) -> Any:
    """The fsspec file system of a URL; None for a local path."""
    return getattr(path, "fs", None)


def fresh(path: Path) -> Path:
    """Return the path after clearing the cached listings of a URL, as others write there too."""
    if remote(path) is not None:
        remote(path).invalidate_cache()
    return path


def matches(url: str) -> list[Path]:
    """Files that match a URL; `**` and folders work as in a local pattern. Raises OSError."""
    root = fresh(place(url))
    fs, key = remote(root), str(getattr(root, "path"))  # noqa: B009 mypy knows a Path only
    try:
        found = fs.glob(key, detail=True) if glob.has_magic(url) else {}
        names = [name for name, info in found.items() if info["type"] == "file"]
        if not found:
            names = fs.find(key)
    except Exception as error:  # each storage has its own errors: no key, no network, no bucket
        msg = f"{url}: {type(error).__name__}: {error}"
        raise OSError(msg) from error
    paths = [place(fs.unstrip_protocol(name)) for name in names]
    hidden = [len([p for p in path.parts if p.startswith(".")]) for path in (root, *paths)]
    return [path for path, n in zip(paths, hidden[1:], strict=True) if n <= hidden[0]]


def state(path: Path) -> dict[str, str]:
    """Size, time and hash of a URL's object, as its storage reports them. Raises OSError.

    The time is in whole seconds: a listing and a query of one object on S3 differ in the fraction.
    """
    fs, key = remote(path), getattr(path, "path")  # noqa: B009 mypy knows a Path only
    info = fs.info(key)
    try:
        mtime_ns = int(fs.modified(key).timestamp()) * 10**9
    except NotImplementedError:  # HTTP
        mtime_ns = 0
    hashed = info.get("ETag") or info.get("etag") or ""
    return {"size_bytes": str(info["size"]), "mtime_ns": str(mtime_ns), "etag": str(hashed)}


@contextmanager
def fetched(path: Path) -> Iterator[Path]:
    """A local copy of a URL's file, or the local file itself. Raises OSError.

    The message of an error raised inside the `with` names the URL, not the copy.
    """
    if remote(path) is None:
        yield path
        return
    with tempfile.TemporaryDirectory(dir=_scratch()) as folder:
        copy = Path(folder) / path.name
        remote(path).get_file(getattr(path, "path"), str(copy))  # noqa: B009
        try:
            yield copy
        except Exception as error:
            error.args = (str(error).replace(str(copy), str(path)),)
            raise


@contextmanager
def writable(folder: Path) -> Iterator[Path]:
    """A local folder whose files are uploaded to a URL at the end, or the local folder itself.

    A file appears on S3 only when its last byte is there. After an exception none is uploaded.
    Raises OSError.
    """
    if remote(folder) is None:
        yield folder
        return
    with tempfile.TemporaryDirectory(dir=_scratch()) as name:
        yield Path(name)
        for file in sorted(path for path in Path(name).rglob("*") if path.is_file()):
            target = folder / file.relative_to(name).as_posix()
            remote(folder).put_file(str(file), getattr(target, "path"))  # noqa: B009


def each(function: Callable[[T], R], items: Sequence[T], *, slow: bool) -> list[R]:
    """Apply the function to each; slow: in threads, because a storage takes some ms to answer."""
    if not slow:
        return [function(item) for item in items]
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


def _scratch() -> str | None:
    """Dask's folder of this worker, as Dask removes the folders of killed workers; else None."""
    from distributed import get_worker

    try:
        return str(get_worker().local_directory)
    except ValueError:  # not in a worker
        return None
