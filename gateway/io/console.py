"""Messages for people go to stderr. Results go to stdout."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

_SHOWN_BY_RICH: Final = frozenset({"FORCE_COLOR", "TTY_COMPATIBLE", "COLUMNS"})
"""Environment variables that change what rich does without a terminal."""


def console() -> Console:
    """A console on stderr."""
    from rich.console import Console

    class Stderr(Console):
        """Leaves a broken pipe to the command line: rich would end the program with 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Stderr(stderr=True)


def note(text: str, *, wrap: bool = False) -> None:
    """Write a line to stderr. Without a terminal, a plain line looks the same without rich.

    wrap: wrap at the width of the terminal, or at 80 columns.
    """
    fits = not wrap or len(text) < 80
    # Two colons may enclose the name of an emoji.
    plain = text.isascii() and text.isprintable() and text.count(":") < 2
    if fits and plain and not sys.stderr.isatty() and not _SHOWN_BY_RICH & os.environ.keys():
        sys.stderr.write(text + "\n")
    else:
        console().print(text, markup=False, soft_wrap=not wrap)
