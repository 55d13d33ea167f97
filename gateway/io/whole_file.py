"""Files that are complete or absent: an incomplete one has another name until it is finished."""

from __future__ import annotations

import csv
import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from typing import Final

PART: Final = ".part"
"""Marks an incomplete file: its name begins with this, or ends with it if the file is kept."""


@contextmanager
def whole(path: Path, *, keep: bool = False) -> Iterator[Path]:
    """Yield a path to write to, renamed to `path` at the end. Makes the folder. Raises OSError.

    After an exception or a signal nothing is left, and an older file of that name stays as it was.
    With `keep`, a file that a signal interrupts stays as `NAME.part`, for data that cannot be
    recorded again. A device or FIFO is written to directly.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if _is_stream(path):
        with _named(path, path):
            yield path
        return
    target = Path(os.path.realpath(path))
    # The suffix stays, as writers depend on it. The leading dot hides it from patterns for logs.
    part = target.with_name(f"{PART}-{os.getpid()}-{target.name}")
    try:
        with _named(part, path):
            yield part
        part.replace(target)
    except KeyboardInterrupt:
        if keep and part.exists():
            part.replace(target.with_name(target.name + PART))
        raise
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder to write to, whose files are moved into `folder` at the end. Raises OSError.

    After an exception or a signal none of them is left, nor a folder made for them.
    `folder` may have other files.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"{PART}-{os.getpid()}"
    part.mkdir(exist_ok=True)
    try:
        with _named(part, folder):
            yield part
        for path in sorted(path for path in part.rglob("*") if not path.is_dir()):
            target = folder / path.relative_to(part)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
    finally:
        rmtree(part, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # it has files
                folder.rmdir()


@contextmanager
def _named(part: Path, path: Path) -> Iterator[None]:
    """Name the user's file or folder `path` in an OSError, not the incomplete `part` of it.

    An OSError of a full disk, quota or size has no name, because `write` knows none.
    """
    try:
        yield
    except OSError as error:
        # Of a copy, `filename` is the source and `filename2` the file that cannot be written.
        name = error.filename2 or error.filename
        if name is None and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OSError(error.errno, error.strerror, str(path)) from error
        if isinstance(name, str | Path) and Path(name).is_relative_to(part) and part != path:
            named = path / Path(name).relative_to(part)
            raise OSError(error.errno, error.strerror, str(named)) from error
        raise


def refuse_unwritable(path: Path) -> None:
    """Raise an OSError if a file cannot be made at `path`: before the work, not after it."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not path.exists() and not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all. Raises OSError."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def write_csv(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV in UTF-8, whole or not at all. Raises OSError."""
    with whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _is_stream(path: Path) -> bool:
    """Whether `path` is no regular file, or names a stream of this process."""
    named = Path(os.path.abspath(path))  # noqa: PTH100 a link such as /dev/stdout is not followed
    return named.parts[1:2] in (("dev",), ("proc",)) or (path.exists() and not path.is_file())
