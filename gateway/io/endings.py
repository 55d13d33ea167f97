"""How a program is ended from outside: Ctrl-C, SIGTERM, a reader that has closed its pipe.

A signal is recorded and raised as an exception between two Python bytecodes; a compiled call
finishes first. Finalisers, library callbacks and a bare `except` can swallow the exception. A
thread detects that the main thread carries on without handling it, and sends the signal again. The
recorded signal decides the exit code.
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
"""Added to the number of the signal that ended a program, gives its exit code, as in shells."""
BROKEN_PIPE: Final = OF_A_SIGNAL + 13
"""As after SIGPIPE, which Python ignores. The 13 is literal: not every system defines SIGPIPE."""
LOOK_S: Final = 0.05
"""Time between two checks of whether the main thread is handling the exception."""
LOOKS: Final = 5
"""Checks in a row without handling, after which the exception counts as swallowed."""
_KINDS: Final = (signal.SIGINT, signal.SIGTERM)


class Ended(KeyboardInterrupt):
    """A signal asks the program to end. A KeyboardInterrupt, because libraries handle Ctrl-C."""

    def __init__(self, number: int) -> None:
        """number: the signal's number."""
        self.number = number
        super().__init__(signal.Signals(number).name)

    @property
    def code(self) -> int:
        """The exit code."""
        return OF_A_SIGNAL + self.number


def ended_by(error: KeyboardInterrupt) -> Ended:
    """The same exception with its signal number; one that Python itself raised is SIGINT."""
    return error if isinstance(error, Ended) else Ended(signal.SIGINT)


class Note:
    """The first signal received, if any."""

    def __init__(self) -> None:
        self.ended: Ended | None = None


@contextmanager
def raised() -> Iterator[Note]:
    """Raise `Ended` on SIGINT and SIGTERM inside the `with`; an ignored signal stays ignored.

    A second signal is raised as well, and so ends the clean-up that the first one started. Does
    nothing outside the main thread.
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
    """Send the signal again whenever `thread` has not been handling it for `LOOKS` checks.

    before: the exception that it was already handling before the signal.
    """
    idle = 0
    while not closed.wait(LOOK_S):
        # Clean-up code after the exception (`finally`, `with`, `except`) counts as handling it.
        idle = idle + 1 if _handled_by(thread) is before else 0
        if idle == LOOKS:
            signal.pthread_kill(thread, number)
            idle = 0


def _handled_by(thread: int) -> BaseException | None:
    """The exception whose `except`, `finally` or `with` block the thread is in."""
    found = sys._current_exceptions().get(thread)  # noqa: SLF001 nothing public tells it
    # Python 3.11 gives a tuple as `sys.exc_info` does, later versions the exception.
    return found[1] if isinstance(found, tuple) else found


def flush() -> None:
    """Flush stdout and stderr. Raises OSError, also if the reader has closed the pipe."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # None if the program was started without it
            stream.flush()


def leave(code: int) -> NoReturn:
    """Run the exit handlers and end the program without tearing down its modules.

    The teardown takes a sixth of the time of a short command, and only frees memory. If other
    threads or processes are still working, the program ends in the usual way.
    """
    working = threading.active_count() > 1 or _children()
    if not working:
        atexit._run_exitfuncs()  # noqa: SLF001 nothing public does it
        silence()
        os._exit(code)
    sys.exit(code)


def _children() -> bool:
    """Whether there are child processes; without `multiprocessing` loaded there are none."""
    loaded = sys.modules.get("multiprocessing")
    return bool(loaded and loaded.active_children())


def silence() -> None:
    """Send a stream whose pipe is broken to /dev/null, or Python reports the pipe as it ends."""
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
