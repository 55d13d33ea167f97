"""Ends of a program from outside: Ctrl-C, SIGTERM, a reader that has closed its pipe.

A signal is noted and raised between two steps of Python; a compiled call is finished first. Some
places swallow the exception: finalisers, callbacks of libraries, a bare `except`. A thread notices
that the main thread works on without handling it, and sends the signal again. The note decides the
exit code.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, NoReturn, TextIO

OF_A_SIGNAL: Final = 128
"""Exit code of a program that signal n has ended, less n, as shells have it."""
BROKEN_PIPE: Final = OF_A_SIGNAL + 13
"""As SIGPIPE, which Python ignores; systems without it have no number for it."""
LOOK_S: Final = 0.05
"""Time between two looks at whether the main thread handles the exception."""
LOOKS: Final = 5
"""After so many looks in a row at which it does not, the exception was swallowed."""
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

    closed = threading.Event()
    main = threading.get_ident()
    before_it = _handled_by(main)

    def handle(number: int, _frame: FrameType | None) -> None:
        error = Ended(number)
        if note.ended is None:
            note.ended = error
            insist = (main, number, closed, before_it)
            threading.Thread(target=_insist, args=insist, daemon=True).start()
        raise error

    usual = sys.unraisablehook

    def swallowed(lost: sys.UnraisableHookArgs) -> None:
        if not isinstance(lost.exc_value, Ended):
            usual(lost)

    before = {kind: signal.getsignal(kind) for kind in _KINDS}
    mine = [kind for kind in _KINDS if before[kind] is not signal.SIG_IGN]
    for kind in mine:
        signal.signal(kind, handle)
    sys.unraisablehook = swallowed
    try:
        yield note
    finally:
        closed.set()
        sys.unraisablehook = usual
        for kind in mine:
            signal.signal(kind, before[kind])


def _insist(
    thread: int, number: int, closed: threading.Event, before: BaseException | None
) -> None:
    """Send the signal again whenever `thread` has handled no exception for `LOOKS` looks.

    before: what it was handling before the signal.
    """
    idle = 0
    while not closed.wait(LOOK_S):
        # What tidies up after the exception (`finally`, `with`, `except`) is handling it.
        idle = idle + 1 if _handled_by(thread) is before else 0
        if idle == LOOKS:
            signal.pthread_kill(thread, number)
            idle = 0


def _handled_by(thread: int) -> BaseException | None:
    """The exception whose `except`, `finally` or `with` the thread is in."""
    found = sys._current_exceptions().get(thread)  # noqa: SLF001 nothing public tells it
    # Python 3.11 has a tuple as of `sys.exc_info`, later ones the exception.
    return found[1] if isinstance(found, tuple) else found


def flush() -> None:
    """Hand over what is still to be printed. Raises OSError, also for who reads it no longer."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # where a program was started without
            stream.flush()


def leave(code: int) -> NoReturn:
    """End the program with what was registered for its end, without taking its modules apart.

    Of a short command that takes a sixth of its time, and all it does is to give memory back. Where
    other threads or processes still work, it ends as usual.
    """
    working = threading.active_count() > 1 or _children()
    if not working:
        atexit._run_exitfuncs()  # noqa: SLF001 nothing public does it
        silence()
        os._exit(code)
    sys.exit(code)


def _children() -> bool:
    """Whether there are child processes; nobody has any who has not loaded `multiprocessing`."""
    loaded = sys.modules.get("multiprocessing")
    return bool(loaded and loaded.active_children())


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
