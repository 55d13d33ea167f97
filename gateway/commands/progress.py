"""Progress of a verb, with the time left: on a terminal, never in a pipe.

Every verb that may take longer than two seconds uses this. A thread draws the bar ten times a
second, so a person sees that the program works even between two steps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from gateway.io.console import console

if TYPE_CHECKING:
    from dbc.frames import Block
    from gateway.io.log_file import Log

T = TypeVar("T")
SPEED_OVER_S: Final = 3600.0
"""The time left is estimated from the steps of this period, because one may take minutes."""


class Progress(AbstractContextManager["Progress"]):
    """Context manager: a bar on stderr if that is a terminal, otherwise nothing."""

    def __init__(
        self, what: str, total: float | None = None, done: float = 0.0, *, by_itself: bool = True
    ) -> None:
        """Prepare the bar; `what`: plain text beside it; total: in any unit, None if unknown.

        by_itself: a thread draws the bar; otherwise only `to` does, for a loop in real time.
        """
        self._bar: Any = None
        self._by_itself = by_itself
        self._shown = what, total, done

    def __enter__(self) -> Progress:
        """Draw the bar."""
        if sys.stderr.isatty():
            from rich.progress import (
                BarColumn,
                TaskProgressColumn,
                TextColumn,
                TimeElapsedColumn,
                TimeRemainingColumn,
            )
            from rich.progress import Progress as Bar

            what, total, done = self._shown
            self._bar = Bar(
                TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(),
                TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
                console=console(), transient=True, speed_estimate_period=SPEED_OVER_S,
                auto_refresh=self._by_itself,
            )  # fmt: skip
            self._bar.start()
            self._task = self._bar.add_task(what, total=total, completed=done)
        return self

    def __exit__(self, *error: object) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def to(self, done: float, what: str | None = None) -> None:
        """Set how much is done; `what`: text of the next step."""
        if self._bar is not None:
            self._bar.update(
                self._task, completed=done, description=what, refresh=not self._by_itself
            )

    def advance(self, by: float = 1.0, what: str | None = None) -> None:
        """Add to how much is done; `what`: text of the next step."""
        if self._bar is not None:
            self._bar.update(self._task, advance=by, description=what)

    def print(self, text: str) -> None:
        """Print a line on stderr, above the bar; in a pipe as well."""
        say = console() if self._bar is None else self._bar.console
        say.print(text, markup=False, highlight=False, soft_wrap=True)


def track(items: Iterable[T], what: str, total: float) -> Iterator[T]:
    """Yield the items; each counts 1 of `total` when the next one is requested."""
    with Progress(what, total) as progress:
        for item in items:
            yield item
            progress.advance()


def track_file(log: Log, path: Path, what: str) -> Iterator[Block]:
    """Yield a log's blocks; the bar shows how much of the file has been read."""
    with Progress(what, path.stat().st_size) as progress:
        for block in log.blocks:
            progress.to(log.reader.bytes_read)
            yield block


def stepped(progress: Progress) -> Callable[[str], None]:
    """Return `step(what)`: it names the next step, and counts the one before as done."""
    steps = 0

    def step(what: str) -> None:
        nonlocal steps
        progress.to(steps, what)
        steps += 1

    return step
