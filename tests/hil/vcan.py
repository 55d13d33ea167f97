"""Run a command where SocketCAN is real: in a network namespace, else in user-mode-linux.

`python tests/hil/vcan.py COMMAND ...` runs one command and passes its output and exit code on.
Natively a namespace of its own keeps the interfaces away from those of the machine. Where the
kernel has no CAN, Debian's user-mode-linux boots (about 4 s) with the host's files as root.
Interfaces are made by whoever runs inside (`ip link add vcan0 type vcan`).
"""

from __future__ import annotations

import contextlib
import functools
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

UML_INIT = Path(__file__).parent / "uml" / "init.sh"
UML_MODULES = Path("/usr/lib/uml/modules")
UML_MEMORY_MB = 2048
UML_REGISTERS = Path(__file__).parent / "uml" / "whole_registers.c"
"""What user-mode-linux needs on a processor with AMX; compiled when a job starts."""
_PASSED_ON = ("LANG", "LC_ALL", "PYTHONPATH", "PYTHONWARNINGS", "TZ")
_PROBE = (
    "ip link add vcan0 type vcan && "
    f"{shlex.quote(sys.executable)} -c "
    "'import socket; socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)'"
)


class Way(NamedTuple):
    """How to get at real SocketCAN: `prefix` of a native command, or user-mode-linux."""

    prefix: tuple[str, ...] = ()
    uml: str = ""
    reason: str = ""
    """Why there is no way; empty if there is one."""


@functools.cache
def way() -> Way:
    """The best way on this machine, or the reason in one line why there is none."""
    native, why_not = _native()
    return Way(prefix=native) if native else guest(f"no real CAN: {why_not}, and ")


def guest(so_far: str = "") -> Way:
    """User-mode-linux, or `so_far` and the reason in one line why it is not possible."""
    kernel = shutil.which("linux.uml")
    missing = [tool for tool in ("insmod", "ip", "poweroff") if not _tool(tool)]
    if kernel is None:
        return Way(reason=f"{so_far}user-mode-linux is not installed")
    if missing:
        return Way(reason=f"{so_far}{', '.join(missing)} missing for the guest")
    if not any(UML_MODULES.glob("*/kernel/drivers/net/can/vcan.ko")):
        return Way(reason=f"{so_far}user-mode-linux has no vcan module")
    if _has_amx() and not _tool("cc"):
        return Way(reason=f"{so_far}with AMX user-mode-linux needs cc")
    return Way(uml=kernel)


def _has_amx() -> bool:
    with contextlib.suppress(OSError):
        return "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    return False


def _native() -> tuple[tuple[str, ...], str]:
    """Prefix of commands that run in a namespace with vcan, or why that cannot be."""
    if not sys.platform.startswith("linux") or not _tool("unshare") or not _tool("ip"):
        return (), "no Linux with unshare and ip"
    prefix = ("unshare", "--net") if os.geteuid() == 0 else ("unshare", "--map-root-user", "--net")
    done = subprocess.run(
        [*prefix, "sh", "-c", _PROBE], capture_output=True, text=True, check=False, env=_path()
    )
    if done.returncode == 0:
        return prefix, ""
    lines = done.stderr.strip().splitlines()
    return (), f"vcan is not possible here ({lines[-1] if lines else 'unknown cause'})"


def _path() -> dict[str, str]:
    return {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"}


def _tool(name: str) -> str | None:
    return shutil.which(name, path=_path()["PATH"])


class Job:
    """A command running where CAN is real; everything it leaves behind is in `directory`."""

    def __init__(self, command: list[str], directory: Path, boot: Path = UML_INIT) -> None:
        """Start it. Raises RuntimeError if there is no way.

        boot: the guest's first process; another than the usual one always gets a guest, in which
        the host's files are read-only but for the directory.
        """
        self._boot = boot
        chosen = way() if boot == UML_INIT else guest()
        if chosen.reason:
            raise RuntimeError(chosen.reason)
        self.directory = directory
        self.output = directory / "output"
        self._console = directory / "console"
        self._exit = directory / "exit"
        script = self._script(command, "uml" if chosen.uml else "namespace")
        (directory / "run.sh").write_text(script, encoding="utf-8")
        with self._console.open("wb") as console:
            self._process = subprocess.Popen(
                self._native_command(chosen) if chosen.prefix else self._uml_command(chosen),
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={
                    **_path(),
                    "HOME": str(directory),
                    **(self._uml_needs() if chosen.uml else {}),
                },
            )
        if chosen.uml:
            _favour(self._process.pid)

    def _script(self, command: list[str], inside: str) -> str:
        environment = {key: os.environ[key] for key in _PASSED_ON if key in os.environ}
        environment |= {"HOME": str(self.directory), "TMPDIR": str(self.directory)}
        environment |= {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
        environment["VCAN_INSIDE"] = inside
        lines = [f"export {key}={shlex.quote(value)}" for key, value in environment.items()]
        return "\n".join([*lines, f"cd {shlex.quote(str(Path.cwd()))}", shlex.join(command)]) + "\n"

    def _native_command(self, chosen: Way) -> list[str]:
        job = shlex.quote(str(self.directory))
        inside = f"ip link set lo up; sh {job}/run.sh >{job}/output 2>&1; echo $? >{job}/exit"
        return [*chosen.prefix, "sh", "-c", inside]

    def _uml_command(self, chosen: Way) -> list[str]:
        may = "rw" if self._boot == UML_INIT else "ro"
        return [
            *(chosen.uml, f"mem={UML_MEMORY_MB}M", "rootfstype=hostfs", "rootflags=/", may),
            *("con=null", "con0=fd:0,fd:1", "quiet", f"init={self._boot.resolve()}"),
            *(f"uml_dir={self.directory}/", f"VCAN_JOB={self.directory}"),
        ]

    def _uml_needs(self) -> dict[str, str]:
        """Where its memory goes, which is a file, and help with the registers of AMX."""
        needs = {"TMPDIR": str(self.directory)}
        with contextlib.suppress(OSError):
            # /dev/shm of a container is often too small.
            if shutil.disk_usage("/dev/shm").free > UML_MEMORY_MB << 20:
                needs["TMPDIR"] = "/dev/shm"
        if _has_amx():
            library = self.directory / "whole_registers.so"
            subprocess.run(
                ["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(UML_REGISTERS)],
                check=True,
            )
            needs["LD_PRELOAD"] = str(library)
        return needs

    def running(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def exit_code(self) -> int | None:
        """Exit code of the command; None while it runs or if the guest died before it ended."""
        try:
            return int(self._exit.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return None

    def tail(self, lines: int = 30) -> str:
        """The last lines of the command's output and, if it left none, of the console."""
        for path in (self.output, self._console):
            with contextlib.suppress(OSError):
                text = path.read_text(encoding="utf-8", errors="replace").strip()
                if text:
                    return "\n".join(text.splitlines()[-lines:])
        return "no output"

    def stop(self) -> None:
        """End it, whatever state it is in. The guest's processes are all in one group."""
        if self.exit_code() is not None:  # it is about to halt
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=10)
        if self.running():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _favour(pid: int) -> None:
    """Keep the guest on one processor and, where we may, before other work.

    It has one processor, and every system call in it passes between two processes of the host:
    17 us on one processor, 83 us across two (measured; a CAN frame costs two to four of them).
    """
    with contextlib.suppress(OSError):  # ended already, or not allowed: slower, not wrong
        os.sched_setaffinity(pid, {_idlest(os.sched_getaffinity(pid))})
        os.setpriority(os.PRIO_PROCESS, pid, -20)
        Path(f"/proc/{pid}/autogroup").write_text("-20", encoding="ascii")


def _idlest(processors: set[int]) -> int:
    """The processor with most idle time in the next moment: other guests keep to theirs."""

    def idle() -> dict[int, int]:
        lines = [line.split() for line in Path("/proc/stat").read_text("ascii").splitlines()]
        return {int(w[0][3:]): int(w[4]) for w in lines if w[0][:3] == "cpu" and w[0] != "cpu"}

    before = idle()
    time.sleep(0.2)
    after = idle()
    return max(processors, key=lambda n: after.get(n, 0) - before.get(n, 0))


def main(arguments: list[str]) -> int:
    """Run one command; output as it comes."""
    if way().reason:
        print(way().reason, file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="vcan-") as name:
        job = Job(arguments, Path(name))
        shown = 0
        try:
            while True:
                running = job.running()
                if job.output.is_file():
                    text = job.output.read_bytes()
                    sys.stdout.buffer.write(text[shown:])
                    sys.stdout.flush()
                    shown = len(text)
                if not running:
                    break
                time.sleep(0.1)
        finally:
            job.stop()
        code = job.exit_code()
        if code is None:
            print(f"the guest ended before the command did:\n{job.tail()}", file=sys.stderr)
            return 2
        return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
