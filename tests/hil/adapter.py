"""A serial CAN adapter at the far end of a pseudo terminal: slcan makes it a link of type `can`."""

from __future__ import annotations

import fcntl
import os
import pty
import socket
import struct
import tty

TIOCSETD, N_SLCAN = 0x5423, 17


class Adapter:
    """The far end of an slcan link."""

    def __init__(self) -> None:
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
        os.write(self.master, text.encode() + b"\r")

    def heard(self) -> list[str]:
        """Complete commands that came down the line, such as `t1A020102`."""
        try:
            return os.read(self.master, 65536).decode().split("\r")[:-1]
        except BlockingIOError:
            return []

    def unplug(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            os.close(self._line)
            self.master = -1


def interfaces() -> list[str]:
    return [name for _, name in socket.if_nameindex()]
