"""Progress of a verb, with the time left: on a terminal, never in a pipe.

Every verb that may take longer than two seconds uses this. The bar is drawn ten times a second by
itself, so a person sees that the program works, also between two steps.
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
    from gateway.io.replay import Log

T = TypeVar("T")
SPEED_OVER_S: Final = 3600.0
"""The time left is worked out from the steps of so long: one may take minutes."""


class Progress(AbstractContextManager["Progress"]):
    """A bar on stderr if a person is watching, else nothing. Context manager."""

    def __init__(
        self, what: str, total: float | None = None, done: float = 0.0, *, by_itself: bool = True
    ) -> None:
        """what: plain text beside the bar; total: of any unit, None where it is not known.

        by_itself: drawn by a thread; else only in `to`, for a loop in real time.
        """
        self._bar: Any = None
        self._by_itself = by_itself
        self._shown = what, total, done

    def __enter__(self) -> Progress:
        """Draw it."""
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
        """Take it away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def to(self, done: float, what: str | None = None) -> None:
        """So much is done; what: what comes next."""
        if self._bar is not None:
            self._bar.update(
                self._task, completed=done, description=what, refresh=not self._by_itself
            )

    def advance(self, by: float = 1.0, what: str | None = None) -> None:
        """So much more is done."""
        if self._bar is not None:
            self._bar.update(self._task, advance=by, description=what)

    def print(self, text: str) -> None:
        """A line on stderr, above the bar; in a pipe as well."""
        say = console() if self._bar is None else self._bar.console
        say.print(text, markup=False, highlight=False, soft_wrap=True)


def track(items: Iterable[T], what: str, total: float) -> Iterator[T]:
    """The items, each of which counts 1 of `total` once it is done with."""
    with Progress(what, total) as progress:
        for item in items:
            yield item
            progress.advance()


def track_file(log: Log, path: Path, what: str) -> Iterator[Block]:
    """A log's blocks, by how much of the file is read."""
    with Progress(what, path.stat().st_size) as progress:
        for block in log.blocks:
            progress.to(log.reader.bytes_read)
            yield block


def stepped(progress: Progress) -> Callable[[str], None]:
    """`step(what comes next)`: the step before it is done."""
    steps = 0

    def step(what: str) -> None:
        nonlocal steps
        progress.to(steps, what)
        steps += 1

    return step
