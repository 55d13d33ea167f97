"""Every other CAN interface, through python-can: the same Transport, polled, no threads.

`can.Notifier` is never used (its thread dies at the first fault of the link). `recv` is called
with timeout 0 only, because python-can times its waiting by the wall clock.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping
from typing import Any

from dbc.frame import FD, SECOND, Frame, Nanos
from dbc.frames import Block, block_of
from dbc.logs.python_can import from_message, to_message
from gateway.io import quick_start
from gateway.io.transport import RETRY_NS, LinkState, SendResult, Status, monotonic_stamp
from gateway.io.wire import pack
from gateway.settings.config import ConfigError

with quick_start.absent("asammdf"):
    import can

BATCH = 4096
"""Most frames read in one call."""
_ECHOING = ("udp_multicast",)
"""Interfaces that receive their own frames even without `receive_own_messages`."""


def complete(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in the settings of `can.conf` and `CAN_*`. ConfigError if no interface is named."""
    try:
        found = can.util.load_config(config=dict(chosen))
    except (can.CanError, ValueError) as error:
        raise ConfigError("bus", [f"{error}; name one with -i and -c"]) from None
    return {key: value for key, value in dict(found).items() if value is not None}


_UNUSABLE = (
    can.CanInterfaceNotImplementedError, AttributeError, ImportError, NameError, TypeError,
    ValueError,
)  # fmt: skip
"""What python-can raises if an option is wrong or the vendor's library is missing."""


class PythonCan:
    """Transport over a `can.Bus` made from python-can's own options."""

    def __init__(
        self,
        options: Mapping[str, Any],
        monotonic_ns: Callable[[], Nanos] = time.monotonic_ns,
        real_ns: Callable[[], Nanos] = time.time_ns,
    ) -> None:
        """Keep the options of `can.Bus`; the clocks are for tests."""
        self.channel = str(options.get("channel", ""))
        echo = options.get("interface") in _ECHOING or bool(options.get("receive_own_messages"))
        self.status = Status(hears_itself=echo)
        self._options = dict(options)
        self._monotonic_ns = monotonic_ns
        self._real_ns = real_ns
        self._bus: can.BusABC | None = None
        self._opened = False
        self._retry_ns: Nanos = 0
        self._empty_ns: Nanos = 0

    def open(self) -> None:
        """See Transport. ConfigError for an interface or option that python-can cannot use."""
        try:
            self._connect(self._monotonic_ns())
        except _UNUSABLE as error:
            raise ConfigError(f"interface {self._options.get('interface')}", [str(error)]) from None

    def close(self) -> None:
        """See Transport."""
        self.status.state = LinkState.ABSENT
        if self._bus is not None:
            bus, self._bus = self._bus, None
            try:
                bus.shutdown()
            except (can.CanError, OSError) as error:
                self.status.note = f"{self.channel}: {error}"

    def receive(self) -> Block:
        """See Transport."""
        now = self._monotonic_ns()
        if self._bus is None and now >= self._retry_ns:
            self._reconnect(now)
        return block_of(self._drain(now))

    def send(self, frame: Frame) -> SendResult:
        """See Transport."""
        count = self.status.count
        if pack(frame) is None or (frame.flags & FD and not self._options.get("fd")):
            return count(SendResult.FAILED)
        if self._bus is None:
            return count(SendResult.DOWN)
        try:
            self._bus.send(to_message(frame._replace(t_ns=0, channel="")), timeout=0)
        except (can.CanError, OSError) as error:
            self.status.note = f"{self.channel}: {error}"
            code = getattr(error, "error_code", None) or getattr(error, "errno", None)
            full = code in (errno.ENOBUFS, errno.EAGAIN)
            return count(SendResult.FULL if full else SendResult.FAILED)
        return count(SendResult.SENT)

    def _connect(self, now: Nanos) -> None:
        self._retry_ns = now + RETRY_NS
        try:
            self._bus = can.Bus(**self._options)
        except can.CanInterfaceNotImplementedError:
            raise
        except (can.CanError, OSError) as error:
            self.status.state = LinkState.ABSENT
            self.status.note = f"{self.channel} is not there: {error}"
            return
        self.status.state = LinkState.UP
        self.status.reopened += self._opened
        self.status.note = ""
        self._opened = True
        self._empty_ns = now

    def _reconnect(self, now: Nanos) -> None:
        try:
            self._connect(now)
        except _UNUSABLE as error:
            self.status.note = f"{self.channel}: {error}"

    def _drain(self, started: Nanos) -> list[Frame]:
        messages: list[can.Message] = []
        emptied = False
        if self._bus is not None:
            try:
                for _ in range(BATCH):
                    message = self._bus.recv(0)
                    if message is None:
                        emptied = True
                        break
                    messages.append(message)
            except (can.CanError, OSError) as error:
                self.close()
                self.status.note = f"{self.channel}: {error}"
                self._retry_ns = self._monotonic_ns() + RETRY_NS
        now, real = self._monotonic_ns(), self._real_ns()  # in this order: see SocketCan
        bound = now - self._empty_ns
        if emptied:
            self._empty_ns = started
        frames = []
        for message in messages:
            stamp = monotonic_stamp(int(message.timestamp * SECOND), real, now, bound)
            frame = from_message(message)._replace(t_ns=stamp, channel=self.channel)
            self.status.saw(frame)
            frames.append(frame)
        return frames
