"""How a command gets real SocketCAN on this machine: natively, or in user-mode-linux."""

from __future__ import annotations

import contextlib
import functools
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final, NamedTuple

UML_MODULES: Final = Path("/usr/lib/uml/modules")
PACKAGES: Final = "user-mode-linux kmod iproute2 can-utils"
"""What Debian and Ubuntu need for the guest."""
_PROBE: Final = (
    "ip link add vcan0 type vcan && "
    f"{shlex.quote(sys.executable)} -c "
    "'import socket; socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)'"
)


class Way(NamedTuple):
    """A way to real SocketCAN: `prefix` of a native command, or path of user-mode-linux."""

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
    missing = [name for name in ("insmod", "ip", "poweroff") if not tool(name)]
    if kernel is None:
        return Way(reason=f"{so_far}user-mode-linux is not installed")
    if missing:
        return Way(reason=f"{so_far}{', '.join(missing)} missing for the guest")
    if not any(UML_MODULES.glob("*/kernel/drivers/net/can/vcan.ko")):
        return Way(reason=f"{so_far}user-mode-linux has no vcan module")
    if has_amx() and not tool("cc"):
        return Way(reason=f"{so_far}with AMX user-mode-linux needs cc")
    return Way(uml=kernel)


def has_amx() -> bool:
    """Whether the processor has AMX, for whose registers user-mode-linux needs `REGISTERS`."""
    with contextlib.suppress(OSError):
        return "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    return False


def searched() -> dict[str, str]:
    """The environment, with the folders of system programs added to PATH."""
    return {**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"}


def tool(name: str) -> str | None:
    """Path of a program of this name; None if there is none."""
    return shutil.which(name, path=searched()["PATH"])


def _native() -> tuple[tuple[str, ...], str]:
    """Prefix of commands that run in a namespace with vcan, or why that is not possible."""
    if not sys.platform.startswith("linux") or not tool("unshare") or not tool("ip"):
        return (), "no Linux with unshare and ip"
    prefix = ("unshare", "--net") if os.geteuid() == 0 else ("unshare", "--map-root-user", "--net")
    done = subprocess.run(
        [*prefix, "sh", "-c", _PROBE], capture_output=True, text=True, check=False, env=searched()
    )
    if done.returncode == 0:
        return prefix, ""
    lines = done.stderr.strip().splitlines()
    return (), f"vcan is not possible here ({lines[-1] if lines else 'unknown cause'})"
