"""What somebody else reads on the bus: flags by python-can and cantools, with none of our code."""

import contextlib
import os
import time
from typing import NamedTuple

import can
import cantools

from tests.programs import await_state

PATIENCE_S = 60.0
ADHESION, FAULTS, STATUS, HEARTBEAT = 0x1A0, 0x2A0, 0x4A0, 0x720
GOOD = 1


class Said(NamedTuple):
    """One `Gateway_Adhesion` frame."""

    t_s: float
    """The kernel's stamp."""
    flags: tuple[int, ...]
    """Raw state of each drive, in order of the nodes."""
    reason: int
    counter: int


class Observer:
    """A listener for the gateway's flags, status and heartbeat."""

    def __init__(self, name, dbc, nodes):
        """Bind to an interface, which may be down; nodes: drives whose flags are read."""
        database = cantools.database.load_file(dbc)
        assert isinstance(database, cantools.database.Database)
        self._adhesion = database.get_message_by_frame_id(ADHESION)
        self._nodes = nodes
        self.heard = 0
        """Frames of any of the four kinds since this was last set to 0."""
        self.flags = []
        """Flag frames since this was last cleared."""
        only = [
            {"can_id": can_id, "can_mask": 0x7FF, "extended": False}
            for can_id in (ADHESION, FAULTS, STATUS, HEARTBEAT)
        ]
        self._bus = can.Bus(interface="socketcan", channel=name, can_filters=only)

    def take(self):
        """Read what waits. A link that goes down is told by an error, once."""
        while True:
            try:
                message = self._bus.recv(0)
            except can.CanOperationError:
                continue
            if message is None:
                return
            if message.is_error_frame:
                continue
            self.heard += 1
            if message.arbitration_id == ADHESION:
                values = self._adhesion.decode(bytes(message.data), decode_choices=False)
                assert isinstance(values, dict)
                flags = tuple(int(str(values[f"Adhesion{n}"])) for n in self._nodes)
                reason, counter = (int(str(values[name])) for name in ("Reason", "Counter"))
                self.flags.append(Said(message.timestamp, flags, reason, counter))

    def forget(self):
        """Read what waits and drop it."""
        self.take()
        self.flags.clear()
        self.heard = 0

    def until(self, fulfilled, what):
        """Read until a condition holds; returns after how many seconds it did."""
        began = time.monotonic()
        while True:
            self.take()
            if fulfilled():
                return time.monotonic() - began
            assert time.monotonic() - began < PATIENCE_S, f"{what}: not within {PATIENCE_S} s"
            time.sleep(0.005)

    def until_flags(self, count):
        """Read until there are so many flag frames; returns after how many seconds."""
        return self.until(lambda: len(self.flags) >= count, f"{count} flag frames")

    def watch(self, seconds):
        """Read for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.take()
            time.sleep(min(left, 0.02))

    def all_good(self):
        """Whether the newest flag frame says that every drive adheres."""
        return bool(self.flags) and set(self.flags[-1].flags) == {GOOD}

    def close(self):
        self._bus.shutdown()


def await_stop(pid):
    """Wait until a signal has stopped a process: what it has not sent by then it does not send."""
    await_state(pid, "T")


def end_process(pid, number):
    """Send a signal to a process that may have gone already."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
