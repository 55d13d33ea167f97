"""One log as a task, which always gives a row, also after an error.

What computes is imported in the workers only: the others need not wait for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from gateway.fleet.logs import Job, Settings, remove_files, shown
from gateway.fleet.table import BAD, Row

Work = Callable[[Job, Settings], Row]
ERROR_LENGTH = 500


def ready(settings: Settings) -> str:
    """Make this process ready to work; says what is wrong with the settings, or nothing."""
    from gateway.fleet.work import prepare

    return prepare(settings)


def one_log(one: Job, settings: Settings) -> Row:
    """Replay a log, leave its file, give its row; a log that cannot be done is a bad row.

    Never raises on a log, whatever it is: there are others to be done.
    """
    from gateway.fleet.work import replayed

    began = time.perf_counter()
    try:
        return replayed(one, settings, began)
    except Exception as error:  # a fault of ours in one log must not stop the others either
        # What an earlier state of the log has left would be taken for this one's.
        remove_files(one, settings)
        return bad(one, error, time.perf_counter() - began)


def bad(one: Job, error: BaseException | str, took_s: float | None = None) -> Row:
    """The row of a log that could not be done, and why."""
    text = " ".join(str(error).split()).removeprefix(f"{one.path}: ")
    if isinstance(error, BaseException) and type(error).__name__ not in ("BadLogError", "LogError"):
        text = f"{type(error).__name__}: {text}"
    size = one.path.stat().st_size if one.path.is_file() else None
    return Row(
        shown(one.path), BAD, text[:ERROR_LENGTH], size_bytes=size,
        took_s=None if took_s is None else round(took_s, 3),
    )  # fmt: skip
