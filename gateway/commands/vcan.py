"""`vcan -- COMMAND ..`: run a command with real SocketCAN, on any Linux machine."""

from __future__ import annotations

import argparse
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from gateway.commands.common import BAD_INPUT
from gateway.settings.config import ConfigError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("--interfaces", metavar="NAME[,NAME]", default="vcan0",
                        help="vcan interfaces, up, with CAN FD (default: vcan0)")  # fmt: skip
    parser.add_argument("--pair", metavar="NAME,NAME", action="append", default=[],
                        help="two vxcan interfaces, connected to each other")  # fmt: skip
    parser.add_argument(
        "--slcan", metavar="NAME", action="append", default=[],
        help="link of a serial adapter, with error states: `echo bus-off >$VCAN_FIFOS/NAME`",
    )  # fmt: skip
    parser.add_argument("--candump", type=Path, metavar="FILE",
                        help="record all frames, as `candump -L any` does")  # fmt: skip
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="-- COMMAND ..",
                        help="the command; its exit code is that of this program")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Return the command's exit code; 2 without SocketCAN, 125 if a link cannot be made."""
    from gateway.hil.vcan.links import Links
    from gateway.hil.vcan.ways import PACKAGES, way

    command = options.command[1:] if options.command[:1] == ["--"] else options.command
    pairs = [tuple(pair.split(",")) for pair in options.pair]
    names = tuple(filter(None, options.interfaces.split(",")))
    problems = [f"--pair {','.join(pair)}: needs two names" for pair in pairs if len(pair) != 2]
    links = Links(names, [(p[0], p[-1]) for p in pairs], options.slcan, options.candump)
    problems += [] if problems else links.problems()
    if not command:
        problems.append("no command; `traction-gateway vcan -- candump vcan0`")
    if problems:
        raise ConfigError("vcan", problems)
    chosen = way()
    if chosen.reason:
        print(f"traction-gateway: {chosen.reason}; Debian: apt-get install {PACKAGES}",
              file=sys.stderr)  # fmt: skip
        return BAD_INPUT
    with TemporaryDirectory(prefix="vcan-") as name:
        folder = Path(name)
        lines = [f"export VCAN_FIFOS={name}", *links.around(command, folder)]
        return _natively(chosen.prefix, lines, folder) if chosen.prefix else _apart(lines, folder)


def _natively(prefix: tuple[str, ...], lines: list[str], folder: Path) -> int:
    """Run in a namespace; the command has this program's input, output and terminal."""
    from gateway.hil.vcan.job import script
    from gateway.hil.vcan.ways import searched

    path = folder / "run.sh"
    environment = {**searched(), "VCAN_INSIDE": "namespace"}
    path.write_text(script(lines, environment), encoding="utf-8")
    sys.stdout.flush()
    process = subprocess.Popen([*prefix, "sh", str(path)], env=environment, process_group=0)

    def send(number: int) -> None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)

    with process, _foreground(process.pid), _forwarded(send):
        code = process.wait()
    return code if code >= 0 else 128 - code


@contextmanager
def _foreground(group: int) -> Iterator[None]:
    """Give the terminal, if there is one, to a process group, as a shell does with a command.

    Ctrl-C then reaches the command once, and not this program as well.
    """
    if not os.isatty(0) or os.tcgetpgrp(0) != os.getpgrp():
        yield
        return
    before = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    os.tcsetpgrp(0, group)
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGCONT)  # it may have read too early, and was stopped
    try:
        yield
    finally:
        os.tcsetpgrp(0, os.getpgrp())
        signal.signal(signal.SIGTTOU, before)


def _apart(lines: list[str], folder: Path) -> int:
    """Run in user-mode-linux; the command has no input."""
    from gateway.hil.vcan.job import Job

    if _has_input():
        text = "a command in user-mode-linux has no standard input; let it read a file"
        print(f"traction-gateway: warning: {text}", file=sys.stderr)
    job = Job(lines, folder, os.environ)
    try:
        with _forwarded(job.send):
            job.pass_on(sys.stdout.buffer, sys.stderr.buffer)
    finally:
        job.stop()
    code = job.exit_code()
    if code is None:
        print(f"traction-gateway: the guest ended before the command did:\n{job.tail()}",
              file=sys.stderr)  # fmt: skip
        return BAD_INPUT
    return code


def _has_input() -> bool:
    """Whether something waits on standard input: a file that is not empty, or bytes in a pipe."""
    import fcntl
    import termios

    try:
        kind = os.fstat(0)
        if stat.S_ISREG(kind.st_mode):
            return os.lseek(0, 0, os.SEEK_CUR) < kind.st_size
        waiting = fcntl.ioctl(0, termios.FIONREAD, bytes(4)) if stat.S_ISFIFO(kind.st_mode) else b""
    except OSError:  # closed
        return False
    return any(waiting)


@contextmanager
def _forwarded(send: Callable[[int], None]) -> Iterator[None]:
    """Forward SIGINT and SIGTERM to the command, which may end itself as it likes."""
    before = {
        kind: signal.signal(kind, lambda number, _frame: send(number))
        for kind in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
