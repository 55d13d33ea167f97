"""Messages for people go to stderr. Results go to stdout."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

_SHOWN_BY_RICH: Final = frozenset({"FORCE_COLOR", "TTY_COMPATIBLE", "COLUMNS"})
"""Variables that change what it does where there is no terminal."""


def console() -> Console:
    """A console on stderr."""
    from rich.console import Console

    class Stderr(Console):
        """Leaves a broken pipe to the command line: rich would end the program with 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Stderr(stderr=True)


def note(text: str, *, wrap: bool = False) -> None:
    """A line on stderr. Where no terminal is asked to show it, it needs no rich to look the same.

    wrap: at the width of the terminal, or at 80 columns.
    """
    fits = not wrap or len(text) < 80
    plain = text.isascii() and text.isprintable() and text.count(":") < 2  # of emoji
    if fits and plain and not sys.stderr.isatty() and not _SHOWN_BY_RICH & os.environ.keys():
        sys.stderr.write(text + "\n")
    else:
        console().print(text, markup=False, soft_wrap=not wrap)
