"""Settings of this machine that harm the gateway, each with the command that corrects it.

Settings are only read, never changed. They are also listed on a bench that does not need them:
missing real-time rights are no fault if no priority is requested.
"""

from __future__ import annotations

import os
import resource
import socket
from pathlib import Path
from typing import Final, NamedTuple

from gateway.io.kernel import RECEIVE_BUFFER
from gateway.io.links import Facts, advice, facts, question

PROC: Final = Path("/proc/sys")
PATIENCE_S: Final = 1.0


class Finding(NamedTuple):
    """One setting: its name, its value, and the command that corrects it (empty if it is right)."""

    what: str
    found: str
    cure: str = ""


def number(path: Path) -> int | None:
    """The integer in a file of /proc/sys; None if it has none."""
    try:
        return int(path.read_text(encoding="ascii").split()[0])
    except (OSError, ValueError, IndexError):
        return None


def receive_buffer(proc: Path = PROC, *, privileged: bool | None = None) -> Finding:
    """Whether the socket gets the buffer that it requests; for root the limit does not apply."""
    most = number(proc / "net/core/rmem_max")
    root = os.geteuid() == 0 if privileged is None else privileged
    if most is None:
        return Finding("receive buffer", "net.core.rmem_max cannot be read")
    if most >= RECEIVE_BUFFER or root:
        return Finding("receive buffer", f"{most >> 10} KiB" + (" (root may take more)" * root))
    return Finding(
        "receive buffer", f"{most >> 10} KiB: a burst of frames can be lost",
        f"sysctl -w net.core.rmem_max={RECEIVE_BUFFER}",
    )  # fmt: skip


def priority() -> Finding:
    """Whether `--realtime` would be granted."""
    most, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if os.geteuid() == 0 or most > 0 or most == resource.RLIM_INFINITY:
        return Finding("priority", "SCHED_FIFO permitted")
    return Finding(
        "priority", "not granted to this user (RLIMIT_RTPRIO is 0)",
        f"echo '{os.environ.get('USER', 'USER')} - rtprio 50' >> /etc/security/limits.conf, "
        "or the service's unit (docs/deploy.md)",
    )  # fmt: skip


def memory_lock() -> Finding:
    """Whether memory can be locked without a limit: the program takes 60 MB."""
    most, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() == 0 or most == resource.RLIM_INFINITY:
        return Finding("locked memory", "no limit")
    return Finding(
        "locked memory", f"at most {most >> 10} KiB",
        "LimitMEMLOCK=infinity in the unit, or `ulimit -l unlimited`",
    )  # fmt: skip


def link(channel: str, bitrate: int = 0, data_bitrate: int = 0) -> list[Finding]:
    """Settings of a SocketCAN interface, from one netlink request.

    bitrate, data_bitrate: as configured, bit/s; 0: not configured.
    """
    name = f"link {channel}"
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return [Finding(name, f"no SocketCAN in this kernel ({error.strerror})",
                        "modprobe can_raw vcan, or another interface (-i)")]  # fmt: skip
    found = _ask(channel)
    if found is None:
        return [Finding(name, "not there",
                        f"ip link add {channel} type vcan && ip link set {channel} up, "
                        "or plug it in")]  # fmt: skip
    return link_findings(channel, found, bitrate, data_bitrate)


def link_findings(channel: str, found: Facts, bitrate: int, data_bitrate: int) -> list[Finding]:
    """Settings of a link from an answer of netlink."""
    name = f"link {channel}"
    state = "up" if found.up else "down"
    words = [found.kind or "unknown kind", state, f"queue {found.queue}"]
    if found.kind == "can":
        words += [f"{found.bitrate} bit/s", f"restart-ms {found.restart_ms}"]
        words += [str(found.state)] if found.state is not None else []
    out = [Finding(name, ", ".join(words),
                   "" if found.up else f"ip link set {channel} up")]  # fmt: skip
    for line in advice(channel, found, bitrate, data_bitrate):
        problem, _, cure = line.partition("; ")
        out.append(Finding(name, problem.removeprefix(f"{channel}: "), cure))
    return out


def _ask(channel: str) -> Facts | None:
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as route:
        route.settimeout(PATIENCE_S)
        route.send(question(channel))
        return facts(route.recv(1 << 16))


def machine() -> list[Finding]:
    """All settings that do not depend on the interface."""
    return [receive_buffer(), priority(), memory_lock()]
