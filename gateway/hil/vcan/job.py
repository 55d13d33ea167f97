"""A command with real SocketCAN.

Natively, a network namespace keeps the interfaces apart from those of the machine. If the kernel
has no CAN, Debian's user-mode-linux boots (about 4 s) with the host's file system as root. Output
of the guest's programs comes back in files, because the guest has a kernel of its own.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Final

from gateway.hil.vcan.ways import Way, guest, has_amx, searched, way

INIT: Final = Path(__file__).parent / "guest" / "init.sh"
REGISTERS: Final = Path(__file__).parent / "guest" / "whole_registers.c"
"""Library that user-mode-linux needs on a processor with AMX; compiled when a job starts there."""
MEMORY_MB: Final = 2048
SHARED: Final = "/dev/shm"  # noqa: S108 the guest's memory: files of a user's own, unlinked at once
_NAME: Final = re.compile(r"[A-Za-z_]\w*")


def script(lines: Sequence[str], environment: Mapping[str, str]) -> str:
    """Text of a shell script that runs lines in the current folder and this environment."""
    exports = [
        f"export {key}={shlex.quote(value)}"
        for key, value in environment.items()
        if _NAME.fullmatch(key)
    ]
    return "\n".join([*exports, f"cd {shlex.quote(str(Path.cwd()))}", *lines]) + "\n"


class Job:
    """A command in a namespace or guest; all files that it leaves are in `directory`."""

    def __init__(
        self, lines: Sequence[str], directory: Path, environment: Mapping[str, str],
        boot: Path = INIT,
    ) -> None:  # fmt: skip
        """Start the command. Raises RuntimeError if neither namespace nor guest is possible.

        lines: shell lines; environment: theirs, to which VCAN_INSIDE is added, `namespace` or
        `uml`; boot: the guest's first process; any but the default always runs in a guest, in which
        the host's files are read-only, except for the directory.
        """
        self._boot = boot
        chosen = way() if boot == INIT else guest()
        if chosen.reason:
            raise RuntimeError(chosen.reason)
        self.directory = directory
        self.output, self.errors = directory / "output", directory / "errors"
        self._console = directory / "console"
        self._exit = directory / "exit"
        inside = {**environment, "VCAN_INSIDE": "uml" if chosen.uml else "namespace"}
        (directory / "run.sh").write_text(script(lines, inside), encoding="utf-8")
        self._native = not chosen.uml
        with self._console.open("wb") as console:
            self._process = subprocess.Popen(
                self._native_command(chosen) if self._native else self._uml_command(chosen),
                stdin=subprocess.PIPE,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={
                    **searched(),
                    "HOME": str(directory),
                    **({} if self._native else self._needs()),
                },
            )
        if not self._native:
            _favour(self._process.pid)

    def _native_command(self, chosen: Way) -> list[str]:
        job = shlex.quote(str(self.directory))
        inside = (
            f"ip link set lo up; sh {job}/run.sh </dev/null >{job}/output 2>{job}/errors; "
            f"echo $? >{job}/exit"
        )
        return [*chosen.prefix, "sh", "-c", inside]

    def _uml_command(self, chosen: Way) -> list[str]:
        may = "rw" if self._boot == INIT else "ro"
        return [
            *(chosen.uml, f"mem={MEMORY_MB}M", "rootfstype=hostfs", "rootflags=/", may),
            *("con=null", "con0=fd:0,fd:1", "quiet", f"init={self._boot.resolve()}"),
            *(f"uml_dir={self.directory}/", f"VCAN_JOB={self.directory}"),
        ]

    def _needs(self) -> dict[str, str]:
        """Environment of the guest: folder for the file of its memory, library for AMX."""
        needs = {"TMPDIR": str(self.directory)}
        with contextlib.suppress(OSError):
            # /dev/shm of a container is often too small.
            if shutil.disk_usage(SHARED).free > MEMORY_MB << 20:
                needs["TMPDIR"] = SHARED
        if has_amx():
            library = self.directory / "whole_registers.so"
            subprocess.run(
                ["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(REGISTERS)], check=True
            )
            needs["LD_PRELOAD"] = str(library)
        return needs

    def running(self) -> bool:
        """Whether the job is still running."""
        return self._process.poll() is None

    def send(self, number: int) -> None:
        """Send a signal to the command and all processes that it started."""
        name = signal.Signals(number).name.removeprefix("SIG")
        with contextlib.suppress(OSError):  # it has ended
            if self._native:
                os.killpg(self._process.pid, number)
            elif self._process.stdin is not None:
                self._process.stdin.write(f"{name}\n".encode())
                self._process.stdin.flush()

    def exit_code(self) -> int | None:
        """Exit code of the command; None while it runs or if the guest died before it ended."""
        try:
            return int(self._exit.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return None

    def tail(self, lines: int = 30) -> str:
        """Last lines of the command's output and errors; of the console if there are none."""
        found: list[str] = []
        for path in (self.output, self.errors, self._console):
            with contextlib.suppress(OSError):
                if path != self._console or not found:
                    text = path.read_text(encoding="utf-8", errors="replace").strip()
                    found += text.splitlines()[-lines:]
        return "\n".join(found) or "no output"

    def pass_on(self, out: BinaryIO, errors: BinaryIO) -> None:
        """Copy the command's output and errors as they appear, until it has ended."""
        read = {self.output: 0, self.errors: 0}
        running = True
        while running:
            running = self.running()
            for path, stream in ((self.output, out), (self.errors, errors)):
                with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
                    file.seek(read[path])
                    new = file.read()
                    stream.write(new)
                    stream.flush()
                    read[path] += len(new)
            if running:
                time.sleep(0.05)

    def stop(self) -> None:
        """End the job in any state. The guest's processes are all in one process group."""
        if self.exit_code() is not None:  # it is about to halt
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=10)
        if self.running():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()


def _favour(pid: int) -> None:
    """Pin the guest to one processor and, if allowed, give it priority over other work.

    The guest has one processor, and its every system call passes between two processes of the host:
    17 us on one processor, 83 us across two (measured; a CAN frame takes two to four such calls).
    """
    with contextlib.suppress(OSError):  # ended already, or not allowed: slower, not wrong
        os.sched_setaffinity(pid, {_idlest(os.sched_getaffinity(pid))})
        os.setpriority(os.PRIO_PROCESS, pid, -20)
        Path(f"/proc/{pid}/autogroup").write_text("-20", encoding="ascii")


def _idlest(processors: set[int]) -> int:
    """The processor that is idle the most in the next 0.2 s: other guests are pinned to theirs."""

    def idle() -> dict[int, int]:
        lines = [line.split() for line in Path("/proc/stat").read_text("ascii").splitlines()]
        return {int(w[0][3:]): int(w[4]) for w in lines if w[0][:3] == "cpu" and w[0] != "cpu"}

    before = idle()
    time.sleep(0.2)
    after = idle()
    return max(processors, key=lambda n: after.get(n, 0) - before.get(n, 0))
