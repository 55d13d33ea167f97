"""Notifications to systemd: ready, alive, and a status line (`Type=notify`, `WatchdogSec=`).

`READY=1` is sent after the first tick whose frames passed the check of `Outputs`; an absent
interface is no fault but a state, which `STATUS=` names. `WATCHDOG=1` is sent after such ticks
only, so neither a loop that hangs nor one that sends nothing is kept alive. Without
`NOTIFY_SOCKET` nothing is sent.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, Self

from dbc.frame import SECOND, Nanos
from gateway.io.live import INTRUDER, LiveSnapshot
from gateway.io.transport import LinkState, SendResult
from gateway.io.wire import BusState

if TYPE_CHECKING:
    from gateway.io.outputs import Outputs

log = logging.getLogger(__name__)

FEEDS: Final = 4
"""Times that the watchdog is fed within its timeout."""
STATUS_NS: Final[Nanos] = SECOND
"""Shortest time between two status lines: a flapping link cannot flood the journal."""


class Manager:
    """The service manager's socket; never blocks, never raises.

    The package `sdnotify` is not used: it blocks on a full socket, sends Latin-1 where UTF-8 is
    expected, and stays connected to a socket that has since been recreated.
    """

    def __init__(self, address: str = "", watchdog_ns: Nanos = 0) -> None:
        """`address` as in `NOTIFY_SOCKET`, empty for none; `watchdog_ns`: 0 without a watchdog."""
        # systemd writes @ for the zero byte that begins an abstract address.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_ns = watchdog_ns

    @classmethod
    def from_environment(cls, given: Mapping[str, str] | None = None) -> Self:
        """Read what sd_notify(3) and sd_watchdog_enabled(3) do; a wrong number: no watchdog."""
        given = os.environ if given is None else given
        ours = given.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = given.get("WATCHDOG_USEC", "")
        watchdog_ns = 1000 * int(usec) if ours and usec.isascii() and usec.isdigit() else 0
        return cls(given.get("NOTIFY_SOCKET", ""), watchdog_ns)

    def say(self, *lines: str) -> bool:
        """Send one message; True if it was taken. A full socket loses it: send it again later."""
        if not self._address:
            return True
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as way:
                way.sendto("\n".join(lines).encode(errors="replace"), self._address)
        except BlockingIOError:
            return False
        except OSError as error:
            log.warning("the service manager cannot be notified: %s", error)
            return False
        return True


class Overseer:
    """Checks every tick and notifies the service manager; problems are logged as well."""

    def __init__(self, outputs: Outputs, manager: Manager, where: str, began_ns: Nanos) -> None:
        """`where` names the bus; `began_ns`: when the program started, for the log."""
        self._outputs = outputs
        self._manager = manager
        self._where = where
        self._began_ns = began_ns
        self._ready = False
        self._feed_ns: Nanos = 0
        self._status = ""
        self._status_ns: Nanos = 0

    def completed(self, seen: LiveSnapshot) -> None:
        """Check a tick; call this at its end."""
        problem = self._outputs.judge(seen.sent, seen.results, seen.now_ns)
        if problem:
            log.error("faulty output, watchdog not fed in this tick: %s", problem)
        if SendResult.FULL in seen.results:
            log.warning("%s: the transmit queue is full, frames are dropped", self._where)
        status = "STATUS=" + self._words(seen, problem)
        if not problem and not self._ready:
            self._begin(seen, status)
        elif status != self._status and seen.now_ns >= self._status_ns:
            self._note(status, seen.now_ns, self._manager.say(status))
        watchdog_ns = self._manager.watchdog_ns
        due = watchdog_ns and seen.now_ns >= self._feed_ns
        if due and self._ready and not problem and self._manager.say("WATCHDOG=1"):
            self._feed_ns = seen.now_ns + watchdog_ns // FEEDS

    def stopping(self) -> None:
        """Notify that the loop has ended; call this before the last frames, of unknown flags."""
        self._manager.say("STOPPING=1", "STATUS=sends Unknown flags and stops")

    def _begin(self, seen: LiveSnapshot, status: str) -> None:
        self._ready = self._manager.say("READY=1", status)
        self._note(status, seen.now_ns, self._ready)
        if self._ready:
            after = (seen.now_ns - self._began_ns) / SECOND
            log.info("ready %.1f s after the program began: %s", after, status[7:])

    def _note(self, status: str, now_ns: Nanos, taken: bool) -> None:
        if taken:
            self._status, self._status_ns = status, now_ns + STATUS_NS

    def _words(self, seen: LiveSnapshot, problem: str) -> str:
        if problem:
            return f"faulty output: {problem}"
        if self._outputs.silent():
            return INTRUDER
        if seen.status.state is not LinkState.UP:
            return f"waits: {seen.status.note or f'{self._where} is {seen.status.state}'}"
        if seen.status.bus_state is BusState.BUS_OFF:
            return f"waits: {self._where} is bus-off"
        return f"runs on {self._where}"
