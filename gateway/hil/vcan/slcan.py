"""A simulated serial CAN adapter on a pseudo terminal, which slcan makes a link of type `can`.

Unlike vcan, such a link has error states up to bus-off, error frames and a queue that fills up, and
can be unplugged. `python -m gateway.hil.vcan.slcan can0 FIFO` holds one; each line written to the
FIFO is a word of `WORDS`, `unplug`, or text in the adapter's protocol (`t18121122`: a frame).
"""

from __future__ import annotations

import fcntl
import os
import pty
import socket
import struct
import subprocess
import sys
import threading
import tty
from typing import Final

TIOCSETD: Final = 0x5423
N_SLCAN: Final = 17
"""Line discipline, from Linux's `tty.h`."""
WORDS: Final = {
    "active": "sa000000", "warning": "sw000100", "passive": "sp000130", "bus-off": "sb000256",
}  # fmt: skip
"""States of the link, with error counters, as an adapter reports them."""


class Adapter:
    """The adapter's end of an slcan link."""

    def __init__(self) -> None:
        """Raises OSError without slcan, or if its link appears outside this network namespace."""
        before = set(interfaces())
        self.master, self._line = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._line)
        fcntl.ioctl(self._line, TIOCSETD, struct.pack("i", N_SLCAN))
        new = set(interfaces()) - before
        if not new:
            raise OSError("slcan links appear outside of this network namespace")
        (self.name,) = new
        os.set_blocking(self.master, False)
        self._rest = ""
        """Of a command whose end has not arrived yet."""

    def says(self, text: str) -> None:
        """Send text to the link: a word of `WORDS`, or text in the adapter's protocol."""
        os.write(self.master, WORDS.get(text, text).encode() + b"\r")

    def commands(self) -> list[str]:
        """Complete commands received from the link, such as `t1A020102`."""
        try:
            text = self._rest + os.read(self.master, 65536).decode()
        except BlockingIOError:
            return []
        *complete, self._rest = text.split("\r")
        return complete

    def unplug(self) -> None:
        """Remove the link, as if the adapter were unplugged."""
        if self.master >= 0:
            os.close(self.master)
            os.close(self._line)
            self.master = -1


def interfaces() -> list[str]:
    """Names of the network interfaces."""
    return [name for _, name in socket.if_nameindex()]


def hold(name: str, fifo: str) -> None:
    """Make a link of this name, up, and execute the lines written to the FIFO, until `unplug`."""
    adapter = Adapter()
    for words in (f"set dev {adapter.name} name {name}", f"set dev {name} up"):
        subprocess.run(["ip", "link", *words.split()], check=True)
    os.set_blocking(adapter.master, True)
    threading.Thread(target=_discard, args=(adapter.master,), daemon=True).start()
    os.mkfifo(fifo)
    while True:
        with open(fifo, encoding="ascii") as lines:  # noqa: PTH123 a fifo is opened anew each time
            for line in lines:
                if line.strip() == "unplug":
                    return adapter.unplug()
                adapter.says(line.strip())


def _discard(line: int) -> None:
    """Read and discard what the link sends: a full line would block it."""
    while os.read(line, 65536):
        pass


if __name__ == "__main__":
    hold(*sys.argv[1:])
