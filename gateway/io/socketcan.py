"""SocketCAN by a raw socket of our own: batch reading, kernel stamps, drop counter, reopening.

python-can's SocketCAN bus is not used: it follows the wall clock, cannot report lost frames,
and receives nothing any more after an interface is deleted and created again.

What the kernel does (Documentation/networking/can.rst, net/can/raw.c) and how this module reacts:
an interface that goes down gives ENETDOWN once, and the socket works again after up, so it is kept;
a removed interface gives ENODEV once and the socket stays unbound, so it is closed, and opening a
new one is tried every 0.5 s; an interface that was created again has another index.
"""

from __future__ import annotations

import errno
import logging
import socket
from collections import deque

from dbc.frame import MS, SECOND, Frame, Nanos
from dbc.frames import EMPTY, Block
from gateway.io.batch import Batch
from gateway.io.kernel import Kernel
from gateway.io.links import Links
from gateway.io.transport import RETRY_NS, LinkState, SendResult, Status
from gateway.io.wire import FD_SIZE, BusState, pack
from gateway.settings.config import ConfigError

log = logging.getLogger(__name__)

LOOK_NS: Nanos = 100 * MS
"""Pause between two checks of the interface's index, flags and MTU."""
BATCH = 4096
"""Most frames read in one call, so that a flood cannot hold the loop."""
MOST_BUS_OFFS, BUS_OFF_WINDOW_NS = 3, 60 * SECOND
"""After more than 3 bus-offs within 60 s nothing is sent until the first of them is 60 s old. A
controller that keeps restarting and going bus-off takes the bus from everybody else."""

STALLED_LOOKS = 10
"""Reads in a row with our own frames still unsent, after which the status notes it."""

_GONE = frozenset((errno.ENODEV, errno.ENXIO, errno.EBADF))
_QUEUE_FULL = frozenset((errno.ENOBUFS, errno.EAGAIN))


class SocketCan:
    """Transport over one SocketCAN interface."""

    def __init__(
        self,
        channel: str,
        *,
        fd: bool = False,
        newest: bool = False,
        links: Links | None = None,
        kernel: Kernel | None = None,
    ) -> None:
        """Name the interface; `fd` also receives and allows CAN FD frames.

        `newest`: nothing is queued behind frames that were handed over before the last read and
        are still waiting, so that after a stall of the bus only those are sent late.
        `links`: second source of the bus state beside error frames, and of wrong settings.
        """
        self.channel = channel
        self.status = Status()
        self._fd = fd
        self._newest = newest
        self._links = links
        self._held = 0  # reads in a row with our own frames still waiting
        self._state_ns: Nanos = 0  # when the bus state was last updated other than by netlink
        self._kernel = kernel or Kernel()
        self._raw: socket.socket | None = None
        self._ifindex = 0
        self._opened = False
        self._batch = Batch(BATCH)
        self._retry_ns: Nanos = 0
        self._look_ns: Nanos = 0
        self._empty_ns: Nanos = 0  # when the queue was last found empty
        self._bus_offs: deque[Nanos] = deque(maxlen=MOST_BUS_OFFS + 1)

    def open(self) -> None:
        """See Transport. ConfigError if the kernel has no CAN at all or forbids it."""
        try:
            self._connect(self._kernel.monotonic_ns())
        except OSError as error:
            msg = f"no SocketCAN in this kernel: {error.strerror}; load can_raw, or use -i virtual"
            raise ConfigError("bus", [msg]) from None
        if self._links is not None and not self._links.start():
            log.warning(
                "netlink is not allowed here: the bus state is known from error frames only"
            )
            self._links = None
        self._ask()

    def close(self) -> None:
        """See Transport."""
        self._drop()
        if self._links is not None:
            self._links.close()

    def _drop(self) -> None:
        if self._raw is not None:
            self._raw.close()
            self._raw = None
        self.status.state = LinkState.ABSENT

    def receive(self) -> Block:
        """See Transport."""
        now = self._kernel.monotonic_ns()
        self._tend(now)
        if self._raw is None:
            return EMPTY
        self._held = self._held + 1 if self._newest and self._kernel.queued(self._raw) else 0
        if self._held == STALLED_LOOKS:
            self.status.note = (
                f"{self.channel}: sent frames are still queued; no new ones are added"
            )
        return self._drain(self._raw, now)

    def send(self, frame: Frame) -> SendResult:
        """See Transport. Nothing is queued while down or bus-off: it would be stale when sent."""
        count = self.status.count
        payload = pack(frame)
        if payload is None or (len(payload) == FD_SIZE and not self._fd):
            return count(SendResult.FAILED)
        raw = self._raw
        if raw is None or self.status.bus_state is BusState.BUS_OFF or self._too_often_off():
            return count(SendResult.DOWN)
        if self._held and self._kernel.queued(raw):
            return count(SendResult.FULL)
        self._held = 0
        try:
            try:
                raw.send(payload)
            except OSError as error:
                # ENETDOWN of a past down may still be pending on the socket; it is reported once.
                if error.errno != errno.ENETDOWN or self.status.state is not LinkState.UP:
                    raise
                raw.send(payload)
        except OSError as error:
            return count(self._send_failed(error))
        return count(SendResult.SENT)

    def _too_often_off(self) -> bool:
        offs = self._bus_offs
        if len(offs) <= MOST_BUS_OFFS:
            return False
        if self._kernel.monotonic_ns() - offs[0] > BUS_OFF_WINDOW_NS:
            return False
        self.status.note = (
            f"{self.channel}: {len(offs)} bus-offs in a minute: nothing is sent until it has passed"
        )
        return True

    def _send_failed(self, error: OSError) -> SendResult:
        if error.errno in _QUEUE_FULL:
            return SendResult.FULL
        if error.errno == errno.ENETDOWN:
            self._down()
            return SendResult.DOWN
        if error.errno in _GONE:
            self._lose(f"{self.channel} is gone")
            return SendResult.DOWN
        self.status.note = f"{self.channel} refuses a frame: {error.strerror}"
        return SendResult.FAILED

    def _connect(self, now: Nanos) -> None:
        """Open and bind. An absent interface is a state; OSError only if it cannot be opened."""
        self._retry_ns = now + RETRY_NS
        try:
            raw = self._kernel.connect(self.channel, self._fd, self._newest)
        except OSError as error:
            if error.errno not in _GONE:
                raise
            self.status.state = LinkState.ABSENT
            self.status.note = f"{self.channel} is not there: {error.strerror}"
            return
        self._raw = raw
        self._ifindex = 0
        self._batch.begin()
        self._empty_ns = self._look_ns = now
        self._held = 0
        self._state_ns = now
        self.status.bus_state = BusState.ACTIVE
        self.status.reopened += self._opened
        self._opened = True
        self.status.note = ""
        self._look(now)

    def _tend(self, now: Nanos) -> None:
        """Reopen an absent interface; check that a present one is still the one we hold."""
        if self._raw is None:
            if now >= self._retry_ns:
                try:
                    self._connect(now)
                except OSError as error:
                    self.status.note = f"{self.channel} cannot be opened: {error.strerror}"
        elif now >= self._look_ns:
            self._look(now)
            self._ask()

    def _look(self, now: Nanos) -> None:
        """Compare the interface's index and flags with those that the socket was bound to."""
        if self._raw is None:
            return
        self._look_ns = now + LOOK_NS
        link = self._kernel.look(self._raw, self.channel)
        if link is None:
            self._lose(f"{self.channel} is gone")
        elif self._ifindex and link.ifindex != self._ifindex:
            self._lose(f"{self.channel} was re-created")
            self._retry_ns = now
        else:
            self._ifindex = link.ifindex
            if not link.up:
                self._down()
            elif self.status.state is not LinkState.UP:
                self.status.state = LinkState.UP
                self.status.note = ""
            if self._fd and link.mtu < FD_SIZE:
                self.status.note = (
                    f"{self.channel} has MTU {link.mtu}: CAN FD frames cannot be sent; "
                    f"ip link set {self.channel} mtu {FD_SIZE}"
                )

    def _ask(self) -> None:
        """Take the bus state from netlink, unless a newer one has come from elsewhere since."""
        if self._links is None or self._raw is None:
            return
        asked, found = self._links.news()
        if found is None or found.ifindex != self._ifindex:
            return
        for line in self._links.advice():
            log.warning("%s", line)
        if (
            found.state is not None
            and asked > self._state_ns
            and found.state is not (before := self.status.bus_state)
        ):
            self.status.bus_state = found.state
            self._moved(before, asked)

    def _moved(self, before: BusState, now: Nanos) -> None:
        """Log the bus state and count a bus-off if the state is not as `before`."""
        state = self.status.bus_state
        if state is before:
            return
        log.log(
            logging.INFO if state is BusState.ACTIVE else logging.WARNING,
            "%s: the controller is %s", self.channel, state,
        )  # fmt: skip
        if state is BusState.BUS_OFF:
            self.status.bus_offs += 1
            self._bus_offs.append(now)

    def _down(self) -> None:
        if self._links is not None:
            self._links.hurry()
        self.status.state = LinkState.DOWN
        self.status.bus_state = BusState.ACTIVE  # down and up restarts the controller
        self._state_ns = self._kernel.monotonic_ns()
        self.status.note = f"{self.channel} is down"

    def _lose(self, note: str) -> None:
        self._drop()
        self.status.note = note
        self._retry_ns = self._kernel.monotonic_ns() + RETRY_NS

    def _drain(self, raw: socket.socket, started: Nanos) -> Block:
        """Read until the queue is empty; stamp each frame by its age in the kernel's stamps.

        `started` is a time before the first read.
        """
        status, kernel, batch = self.status, self._kernel, self._batch
        emptied = False
        for _ in range(BATCH):
            if batch.full:
                break
            try:
                emptied = kernel.read(raw, batch)
                if emptied:
                    break
            except BlockingIOError:
                emptied = True
                break
            except OSError as error:
                if error.errno == errno.ENETDOWN:  # reported once; frames may be waiting behind it
                    self._down()
                    continue
                if error.errno in _GONE:
                    self._lose(f"{self.channel} is gone")
                else:
                    status.note = f"{self.channel} cannot be read: {error.strerror}"
                break
        if not batch.filled:
            self._empty_ns = started
            return EMPTY
        # In this order, and bounded from before the read: a process that stands still in between
        # takes frames for older than they are, never for newer.
        now, real = kernel.monotonic_ns(), kernel.real_ns()
        bound = now - self._empty_ns
        if emptied:
            self._empty_ns = started
        block, malformed, errors, dropped = batch.to_block(real, now, bound, self.channel)
        status.malformed += malformed
        status.kernel_drops += dropped
        if errors or status.bus_state is BusState.BUS_OFF:
            before_all = status.bus_state
            for frame in block.frames():
                before = status.bus_state
                status.saw(frame, from_wire=self._links is None)
                self._moved(before, now)
            if errors or status.bus_state is not before_all:
                self._state_ns = now
            if self._links is not None:
                self._links.hurry()
        else:
            status.received += block.size
        return block
