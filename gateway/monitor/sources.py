"""Sources of a monitor's frames: a bus, which is only read, or a log, with its own time.

This module handles sockets, files and clocks; the observer interprets the frames.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import zip_longest
from typing import Any, Final, Protocol

from dbc.frame import MS, Nanos
from dbc.frames import EMPTY, Block, join
from gateway.io.transport import LinkState, Transport
from gateway.monitor.model.observer import Observer
from gateway.monitor.model.snapshot import Snapshot

LISTEN_ONLY: Final[Mapping[str, Mapping[str, Any]]] = {
    "cantact": {"monitor": True},
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
}
"""Bus option by python-can's interface that keeps the controller from sending."""
READ_S: Final = 0.01
"""Time between two reads. A kernel buffers at least some hundred frames for a socket."""
HANGS_NS: Final[Nanos] = 100 * MS
MOST_WAITING: Final = 200_000
"""Most frames that wait to be fetched: ten seconds of a full bus."""


class Source(Protocol):
    """Source of snapshots, with control of its time. Used by one thread at a time."""

    title: str
    """The bus or the log, for a heading."""
    paused: bool
    speed: float
    """Speed of a log as a multiple of real time; for a bus always 1."""

    @property
    def span_s(self) -> tuple[float, float] | None:
        """First and last time for `seek`; None on a bus."""

    @property
    def behind(self) -> bool:
        """Whether a seek is not complete yet; `advance` continues it."""

    def advance(self, wall_dt_s: float) -> Snapshot:
        """Let `wall_dt_s` pass and return a snapshot. Never takes much longer than 0.1 s."""

    def seek(self, t_s: float, patience_s: float | None = None) -> Snapshot:
        """Go to a time of the log, clipped to its span; on a bus this has no effect.

        patience_s: most time of work in this call; None: until the seek is complete.
        """

    def close(self) -> None:
        """Release the bus or file."""


class Reader:
    """Reads a bus in its own thread, so that slow drawing loses no frames. It never sends."""

    def __init__(self, transport: Transport, clock: Callable[[], Nanos]) -> None:
        """transport: open; from now on only this object may use it."""
        self._transport = transport
        self._clock = clock
        self._lock = threading.Lock()
        self._waiting: deque[Block] = deque()
        self._frames = 0
        self.unread = 0
        """Frames dropped because they were not fetched."""
        self._stop = threading.Event()
        self._now = clock()
        self._thread = threading.Thread(target=self._run, name="monitor-reader", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        # Waiting for each frame would wake the thread thousands of times a second.
        while not self._stop.wait(READ_S):
            block = self._transport.receive()
            with self._lock:
                self._now = self._clock()
                if block.size:
                    self._waiting.append(block)
                    self._frames += block.size
                while self._frames > MOST_WAITING and len(self._waiting) > 1:
                    dropped = self._waiting.popleft().size
                    self._frames -= dropped
                    self.unread += dropped

    def fetch(self) -> tuple[Block, Nanos]:
        """All frames read and not fetched yet, and the time up to which they are complete."""
        with self._lock:
            blocks = list(self._waiting)
            self._waiting.clear()
            self._frames = 0
            # If reading hangs, time must still advance, so that received values become stale.
            now = max(self._now, self._clock() - HANGS_NS)
        while len(blocks) > 1:
            pairs = zip_longest(blocks[::2], blocks[1::2], fillvalue=EMPTY)
            blocks = [join(one, other) for one, other in pairs]
        return blocks[0] if blocks else EMPTY, now

    def close(self) -> None:
        """End the thread, then the transport."""
        self._stop.set()
        self._thread.join()
        self._transport.close()


class LiveSource:
    """A bus as a source. It never sends: its transport is made with an empty allow-list."""

    span_s = None
    behind = False

    def __init__(
        self,
        transport: Transport,
        observer: Observer,
        title: str,
        clock: Callable[[], Nanos] = time.monotonic_ns,
    ) -> None:
        """transport: open. clock: the clock of its stamps."""
        self.title = title
        self.paused = False
        self.speed = 1.0
        self._status = transport.status
        self._reader = Reader(transport, clock)
        self._observer = observer
        self._shown: Snapshot | None = None

    def advance(self, wall_dt_s: float) -> Snapshot:  # noqa: ARG002 - the bus has its own time
        """See Source. While paused, frames are still read; only the snapshot stays the same."""
        block, now = self._reader.fetch()
        self._observer.add_frames(block, now)
        if self._shown is None or not self.paused:
            self._shown = self._look(now)
        return self._shown

    def seek(self, t_s: float, patience_s: float | None = None) -> Snapshot:  # noqa: ARG002
        """See Source."""
        return self.advance(0.0)

    def close(self) -> None:
        """See Source."""
        self._reader.close()

    def _look(self, now: Nanos) -> Snapshot:
        shown, status = self._observer.snapshot(now), self._status
        link = shown.link._replace(unread=status.kernel_drops + self._reader.unread)
        if status.state is not LinkState.UP:
            link = link._replace(state=status.state)
        elif link.state == "active":
            # The transport also asks the kernel, which has the state from before this monitor.
            link = link._replace(state=status.bus_state)
        return shown._replace(link=link)


def silently(options: Mapping[str, Any]) -> dict[str, Any]:
    """Bus options with the listen-only mode of the interface, if python-can supports one.

    Such a controller does not even acknowledge. Other interfaces rely on the empty allow-list.
    """
    switch = LISTEN_ONLY.get(str(options.get("interface")), {})
    given = {**switch, **(options.get("bus_kwargs") or {})}
    return {**options, "bus_kwargs": given} if given else dict(options)
