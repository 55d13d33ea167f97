"""A clock and a transport that only a test moves: real time without waiting for it."""

from dbc.frame import SECOND
from dbc.frames import block_of
from gateway.io.transport import LinkState, SendResult, Status


class Clock:
    """Stands still but for sleeping, which takes `late_ns` more than asked."""

    def __init__(self, now=1000 * SECOND):
        self.now = now
        self.late_ns = 0
        self.sleeps = 0

    def __call__(self):
        return self.now

    def seconds(self):
        return self.now / SECOND

    def sleep(self, seconds):
        self.sleeps += 1
        self.now += round(seconds * SECOND) + self.late_ns


def frames_of(bus):
    """The frames that wait at a transport."""
    return list(bus.receive().frames())


class Bus:
    """Gives nothing, and keeps what it is given; `calls` are the others, in their order."""

    def __init__(self):
        self.status = Status(state=LinkState.UP)
        self.sent = []
        self.calls = []

    def open(self):
        self.calls.append("open")

    def waiting_frames(self):
        self.calls.append("receive")
        return []

    def receive(self):
        return block_of(self.waiting_frames())

    def send(self, frame):
        self.sent.append(frame)
        return self.status.count(SendResult.SENT)

    def close(self):
        self.calls.append("close")
