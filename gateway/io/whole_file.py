"""Files that are complete or absent: an incomplete one has another name until it is finished."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

PART: Final = ".part"
"""In the name of every file that is not whole: it begins with it, or ends with it where kept."""


@contextmanager
def whole(path: Path, *, keep: bool = False) -> Iterator[Path]:
    """A name to write to, which becomes `path` at the end. Makes the folder. Raises OSError.

    After an exception or a signal nothing is left and an older file of that name stays as it was;
    with `keep`, what a signal has ended stays as `NAME.part`: for what cannot be recorded again. A
    device or FIFO is written to as it is.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if _is_stream(path):
        with _named(path):
            yield path
        return
    target = Path(os.path.realpath(path))
    # The suffix stays: writers go by it. A leading dot, so that no pattern takes it for a log.
    part = target.with_name(f"{PART}-{os.getpid()}-{target.name}")
    try:
        with _named(path):
            yield part
        part.replace(target)
    except KeyboardInterrupt:
        if keep and part.exists():
            part.replace(target.with_name(target.name + PART))
        raise
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Names the file where a full disk, which writing alone meets, is reported without a name."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def write_text(path: Path, text: str) -> None:
    """The text as UTF-8, line ends as they are; whole or not at all. Raises OSError."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def _is_stream(path: Path) -> bool:
    """True for what is no regular file, and for names of this process's own streams."""
    named = Path(os.path.abspath(path))  # noqa: PTH100 a link such as /dev/stdout is not followed
    return named.parts[1:2] in (("dev",), ("proc",)) or (path.exists() and not path.is_file())
