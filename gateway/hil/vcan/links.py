"""The interfaces of a command, as shell commands that run before and after it."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

FD_MTU: Final = 72
"""MTU of a link that carries CAN FD (Linux's CANFD_MTU)."""
LOOPBACK: Final = ("ip link set lo multicast on up", "ip route add 224.0.0.0/4 dev lo 2>/dev/null")
"""Multicast on `lo`, the only network, for buses such as python-can's `udp_multicast`."""
FAILED: Final = 125
"""Exit code if the links could not be made; `env` and `timeout` use it for their own failure."""
_NAME: Final = re.compile(r"[A-Za-z0-9_.][A-Za-z0-9_.-]{0,14}")


class Links(NamedTuple):
    """Links for a command: names of vcan links, pairs of vxcan links, names of slcan links.

    record: file in which `candump -L` records all links meanwhile; None: no record.
    """

    vcan: Sequence[str] = ("vcan0",)
    vxcan: Sequence[tuple[str, str]] = ()
    slcan: Sequence[str] = ()
    record: Path | None = None

    def problems(self) -> list[str]:
        """Problems of the names and the record, one per line."""
        names = [*self.vcan, *(name for pair in self.vxcan for name in pair), *self.slcan]
        odd = [
            f"{name!r} is not a name of an interface" for name in names if not _NAME.fullmatch(name)
        ]
        twice = sorted({name for name in names if names.count(name) > 1})
        found = odd + [f"{name} is there twice" for name in twice]
        if self.record is not None and not self.record.absolute().parent.is_dir():
            found.append(f"--candump {self.record}: no such folder")
        elif self.record is not None and self.record.is_dir():
            found.append(f"--candump {self.record}: is a folder; name a file")
        return found

    def around(self, command: Sequence[str], fifos: Path) -> list[str]:
        """Shell lines that make the links, run the command and end with its exit code.

        fifos: folder for the FIFOs of the slcan links.
        """
        made = [f"{line} || exit {FAILED}" for line in self.making()]
        for name in self.slcan:
            fifo = shlex.quote(str(fifos / name))
            hold = f"{shlex.quote(sys.executable)} -m gateway.hil.vcan.slcan {name} {fifo}"
            made += [
                f"setsid {hold} & adapter=$!",
                f"until [ -p {fifo} ]; do kill -0 $adapter || exit {FAILED}; sleep 0.1; done",
            ]
        # A signal is meant for the command: the shell goes on, and ends with its exit code. Adapter
        # and recorder have sessions of their own (setsid), and last until the command has ended.
        return ["trap : INT TERM", *LOOPBACK, *made, *self.recorded(shlex.join(command))]

    def making(self) -> list[str]:
        """Shell lines that make the vcan and vxcan links."""
        up = f"mtu {FD_MTU} up"
        lines = []
        for name in self.vcan:
            lines += [f"ip link add name {name} type vcan", f"ip link set dev {name} {up}"]
        for one, other in self.vxcan:
            lines += [f"ip link add name {one} type vxcan peer name {other}"]
            lines += [f"ip link set dev {name} {up}" for name in (one, other)]
        return lines

    def recorded(self, command: str) -> list[str]:
        """Shell lines that run the command and record meanwhile."""
        if self.record is None:
            return [command]
        record = shlex.quote(str(self.record.absolute()))
        listening = "grep -q ' raw$' /proc/net/can/rcvlist_all"
        asleep = "grep -q '^State:.S' /proc/$candump/status 2>/dev/null"
        return [
            f"setsid candump -L any >{record} & candump=$!",
            f"until {listening}; do kill -0 $candump || exit {FAILED}; sleep 0.05; done",
            command,
            "code=$?",
            # Frames that candump has not read when it ends are lost. It sleeps once it has read
            # all; on a bus that others keep full it never does.
            f"looks=0; until {asleep} || [ $((looks += 1)) -gt 200 ]; do sleep 0.05; done",
            "kill $candump 2>/dev/null; wait $candump",
            "exit $code",
        ]
