"""How a program is ended from outside: Ctrl-C, SIGTERM, a reader that has left its pipe.

A signal is noted and raised between two steps of Python; a compiled call is finished first. Where
Python can raise nothing (callbacks of libraries, finalisers) it is raised a moment later. The note
decides the exit code, so that an exception which something has swallowed counts as well.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, TextIO

OF_A_SIGNAL: Final = 128
"""Exit code of a program that signal n has ended, less n, as shells have it."""
BROKEN_PIPE: Final = OF_A_SIGNAL + 13
"""As SIGPIPE, which Python ignores; systems without it have no number for it."""
AGAIN_S: Final = 0.02
"""After so long a signal comes once more that was swallowed."""
_KINDS: Final = (signal.SIGINT, signal.SIGTERM)


class Ended(KeyboardInterrupt):
    """A signal asks the program to end; libraries know what to do at Ctrl-C."""

    def __init__(self, number: int) -> None:
        """number: of the signal."""
        self.number = number
        super().__init__(signal.Signals(number).name)

    @property
    def code(self) -> int:
        """The exit code."""
        return OF_A_SIGNAL + self.number


def ended_by(error: KeyboardInterrupt) -> Ended:
    """The same with its number; what Python itself has raised is Ctrl-C."""
    return error if isinstance(error, Ended) else Ended(signal.SIGINT)


class Note:
    """The first signal, if one has come."""

    def __init__(self) -> None:
        """None yet."""
        self.ended: Ended | None = None


@contextmanager
def raised() -> Iterator[Note]:
    """SIGINT and SIGTERM raise `Ended` meanwhile; what was ignored before stays ignored.

    A second one is raised as well: it ends what tidies up. Does nothing outside the main thread.
    """
    note = Note()
    if threading.current_thread() is not threading.main_thread():
        yield note
        return

    timers: list[threading.Timer] = []

    def handle(number: int, _frame: FrameType | None) -> None:
        error = Ended(number)
        note.ended = note.ended or error
        raise error

    usual = sys.unraisablehook

    def swallowed(lost: sys.UnraisableHookArgs) -> None:
        if not isinstance(lost.exc_value, Ended):
            usual(lost)
            return
        again = (threading.main_thread().ident, lost.exc_value.number)
        timers[:] = [threading.Timer(AGAIN_S, signal.pthread_kill, again)]
        timers[0].daemon = True
        timers[0].start()

    before = {kind: signal.getsignal(kind) for kind in _KINDS}
    mine = [kind for kind in _KINDS if before[kind] is not signal.SIG_IGN]
    for kind in mine:
        signal.signal(kind, handle)
    sys.unraisablehook = swallowed
    try:
        yield note
    finally:
        sys.unraisablehook = usual
        for timer in timers:
            timer.cancel()
        for kind in mine:
            signal.signal(kind, before[kind])


def flush() -> None:
    """Hand over what is still to be printed. Raises OSError, also for who reads it no longer."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # where a program was started without
            stream.flush()


def silence() -> None:
    """Print into nothing from now on: else Python complains of a broken pipe as it ends."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            _empty(stream)


def _empty(stream: TextIO) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, stream.fileno())
    finally:
        os.close(nowhere)
