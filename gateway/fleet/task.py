"""One log as a task, which always returns a row, also after an error.

The modules that compute are imported in the workers only, so that other processes start faster.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from gateway.fleet.logs import Job, Settings, remove_files, shown
from gateway.fleet.table import BAD, Row

Work = Callable[[Job, Settings], Row]
ERROR_LENGTH = 500


def ready(settings: Settings) -> str:
    """Prepare this process for work; return the problem of the settings, empty if none."""
    from gateway.fleet.work import prepare

    return prepare(settings)


def one_log(one: Job, settings: Settings) -> Row:
    """Replay a log, write its file, return its row; a bad row for a log that cannot be replayed.

    Never raises an Exception because of a log, so that the others are still done.
    """
    from gateway.fleet.work import replayed

    began = time.perf_counter()
    try:
        return replayed(one, settings, began)
    except Exception as error:  # a bug of ours at one log must not stop the others either
        # The file of an earlier state of the log would be taken for that of this one.
        remove_files(one, settings)
        return bad(one, error, time.perf_counter() - began)


def bad(one: Job, error: BaseException | str, took_s: float | None = None) -> Row:
    """The row of a log that could not be replayed, with the error."""
    text = " ".join(str(error).split()).removeprefix(f"{one.path}: ")
    if isinstance(error, BaseException) and type(error).__name__ not in ("BadLogError", "LogError"):
        text = f"{type(error).__name__}: {text}"
    size = one.path.stat().st_size if one.path.is_file() else None
    return Row(
        shown(one.path), BAD, text[:ERROR_LENGTH], size_bytes=size,
        took_s=None if took_s is None else round(took_s, 3),
    )  # fmt: skip
