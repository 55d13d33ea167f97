"""A source without a bus or a log, and a real server, for the tests of the monitor's page."""

import socket
import threading
import time
from contextlib import contextmanager

from gateway.core.codes import FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.monitor.model.access import Access, Listen
from gateway.monitor.model.snapshot import DriveRow, GatewayRow, Lateness, LinkRow, Snapshot, Trace
from gateway.monitor.web import bind, make_app, make_server

FULL = DriveRow(
    1, Flag.GOOD, Flag.BAD, Health.TRACKING, 25.5, 25.4, 26.1, 1.7, 0.25, 0.4, 87.2, 47.9, 47.6,
    20.2, 60.7, 1.29, FaultClass.BEARING, FaultSensor.DRIVE_END, 3, 0.125, "Operation",
    "Operational", 7, 0.002,
)  # fmt: skip
EMPTY = DriveRow(2)
GATEWAY = GatewayRow(
    True, True, "bus", GatewayState.RUNNING, Reason.STALE, Reason.CONFIG, 12.0, 3.0, "Median",
    Flag.GOOD, Flag.BAD, Flag.UNKNOWN, Flag.GOOD, Flag.GOOD, 4, 5, 6, 49.0, "3ba3f4", 1500.0,
    250.0, "Operational",
)  # fmt: skip
LINK = LinkRow("warning", 51.5, 3667.0, 26253, 2, 1, {"crc": 3, "sequence": 1})
LATE = Lateness((0, 1, 2, 4, 8), (10, 20, 0, 5), 35, 7, 7)


def snapshot(t_s=1.0, points=10, events=(), **changes):
    """Two drives, of which the second was never heard."""
    first = round(t_s * 10) - points + 1
    t = tuple((first + k) / 10 for k in range(points))
    lost = (None, *[0.123456] * (points - 1))
    flags = (Flag.UNKNOWN, *[Flag.GOOD] * (points - 1))
    history = tuple(Trace(n, t, lost, lost, lost, lost, flags) for n in (1, 2))
    shown = Snapshot(t_s, GATEWAY, (FULL, EMPTY), LINK, LATE, events, (0.0, 60.0), history)
    return shown._replace(**changes)


class FakeSource:
    """Time goes on as told; what was asked of it is kept in `log`."""

    title = "a.log"

    def __init__(self, *, live=False, make=snapshot):
        self.paused, self.speed = False, 1.0
        self.span_s = None if live else (0.0, 60.0)
        self.behind = self.closed = False
        self.t_s = 1.0
        self.make = make
        self.log = []

    def advance(self, wall_dt_s):
        self.log.append(("advance", wall_dt_s))
        if not self.paused:
            self.t_s += wall_dt_s * self.speed
        return self.make(self.t_s)

    def seek(self, t_s, patience_s=None):
        self.log.append(("seek", t_s))
        self.t_s = min(t_s, 60.0)
        return self.make(self.t_s)

    def close(self):
        self.closed = True


@contextmanager
def server_of(feed, *, stuck_ms=None, port=0, request_s=5.0, **limits):
    """A real one, by default on a port of its own: (server, port)."""
    made = bind(Listen("127.0.0.1", port))
    if stuck_ms is not None:
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, stuck_ms)
    server = make_server(make_app(feed, Access(), **limits), feed.counts, request_s)
    thread = threading.Thread(target=server.run, args=([made],))
    thread.start()
    try:
        until(lambda: server.started)
        yield server, made.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(60)
        made.close()
    assert not thread.is_alive()


def until(met, limit_s=60.0):
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline, "this never came"
        time.sleep(0.02)
