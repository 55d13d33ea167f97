"""Where people are told things: stderr. Results go to stdout."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def console() -> Console:
    """A console on stderr."""
    from rich.console import Console

    class Stderr(Console):
        """Leaves a broken pipe to the command line: rich would end the program with 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Stderr(stderr=True)
