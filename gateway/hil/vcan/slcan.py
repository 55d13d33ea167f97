"""A serial CAN adapter at the far end of a pseudo terminal: slcan makes it a link of type `can`.

Such a link has what vcan has not: error states up to bus-off, error frames, a queue that fills up,
a plug. `python -m gateway.hil.vcan.slcan can0 FIFO` holds one; each line that is written into the
fifo is a word of `WORDS`, `unplug`, or text in the adapter's own language (`t18121122`: a frame).
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
"""Line discipline, Linux's `tty.h`."""
WORDS: Final = {
    "active": "sa000000", "warning": "sw000100", "passive": "sp000130", "bus-off": "sb000256",
}  # fmt: skip
"""States of the link, with counters of errors as an adapter reports them."""


class Adapter:
    """The far end of an slcan link."""

    def __init__(self) -> None:
        """OSError if there is no slcan, or its link appears outside of this network namespace."""
        before = set(interfaces())
        self.master, self._line = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._line)
        fcntl.ioctl(self._line, TIOCSETD, struct.pack("i", N_SLCAN))
        new = set(interfaces()) - before
        if not new:
            msg = "slcan links appear outside of this network namespace"
            raise OSError(msg)
        (self.name,) = new
        os.set_blocking(self.master, False)

    def says(self, text: str) -> None:
        """What the link is to hear: text in the adapter's language, or one of `WORDS`."""
        os.write(self.master, WORDS.get(text, text).encode() + b"\r")

    def commands(self) -> list[str]:
        """Complete commands that came down the line, such as `t1A020102`."""
        try:
            return os.read(self.master, 65536).decode().split("\r")[:-1]
        except BlockingIOError:
            return []

    def unplug(self) -> None:
        """The link is gone."""
        if self.master >= 0:
            os.close(self.master)
            os.close(self._line)
            self.master = -1


def interfaces() -> list[str]:
    """Names of the network interfaces."""
    return [name for _, name in socket.if_nameindex()]


def hold(name: str, fifo: str) -> None:
    """Make a link of this name, up, and do what is written into the fifo, until `unplug`."""
    adapter = Adapter()
    for words in (f"set {adapter.name} name {name}", f"set {name} up"):
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
    """Read what the link sends: a full line would stop it."""
    while os.read(line, 65536):
        pass


if __name__ == "__main__":
    hold(*sys.argv[1:])
