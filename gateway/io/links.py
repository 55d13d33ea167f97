"""State and settings of a CAN link, as the kernel reports them over netlink.

An error frame reports a change once, and may be lost or never be made; netlink is the second
source, and has what no frame carries: `restart-ms`, bit rates, the length of the queue.

The kernel answers under a lock, which setting up any link holds until it is done. So a thread asks
(two system calls of 3 us), and the loop only reads the answer: it takes 0.1 ms (by pyroute2) to
decode one that differs from the one before.
This module never changes anything by netlink. Formats: rtnetlink(7), linux/can/netlink.h.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Final, NamedTuple

from dbc.frame import MS, SECOND, Nanos
from gateway.io.wire import BusState

ASK_NS: Final[Nanos] = 500 * MS
"""Pause between two requests, unless `hurry` asks for one at once."""
PATIENCE_S: Final = 1.0
LONGEST_QUEUE: Final = 100
"""Frames; a longer queue is reported. The kernel's default for a CAN controller is 10."""
RESTART_MS: Final = 100
"""Value that the advice recommends: long enough not to take the bus from others."""

_GETLINK, _NEWLINK, _REQUEST = 18, 16, 1
_IFNAME, _EXT_MASK, _SKIP_STATS = 3, 29, 8
_HEAD, _BODY, _ATTRIBUTE = struct.Struct("=IHHII"), struct.Struct("=BxHiII"), struct.Struct("=HH")
_UP = 1
_STATES: Final = {
    "ERROR_ACTIVE": BusState.ACTIVE,
    "ERROR_WARNING": BusState.WARNING,
    "ERROR_PASSIVE": BusState.PASSIVE,
    "BUS_OFF": BusState.BUS_OFF,
}


class Facts(NamedTuple):
    """State and settings of a link, as one answer gives them."""

    ifindex: int
    up: bool
    kind: str
    """`can` has a controller; `vcan` and `vxcan` have none, and no bit rate."""
    state: BusState | None
    """None without a controller, and if the driver reports none of `_STATES` (link down)."""
    restart_ms: int
    bitrate: int
    """bit/s; 0 if the driver does not say."""
    data_bitrate: int
    queue: int
    """Frames that may wait for the controller (`txqueuelen`)."""


def question(channel: str) -> bytes:
    """RTM_GETLINK by name, without statistics, so that answers differ only after a change."""
    name = channel.encode()[:15] + b"\0"
    body = _BODY.pack(0, 0, 0, 0, 0)
    body += _ATTRIBUTE.pack(4 + len(name), _IFNAME) + name + bytes(-len(name) % 4)
    body += _ATTRIBUTE.pack(8, _EXT_MASK) + struct.pack("=I", _SKIP_STATS)
    return _HEAD.pack(_HEAD.size + len(body), _GETLINK, _REQUEST, 1, 0) + body


def facts(answer: bytes) -> Facts | None:
    """Decode an answer; None if it describes no link, such as "no such device"."""
    # Loading pyroute2 takes 0.1 to 0.2 s, so it is loaded only where SocketCAN is opened.
    from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

    if len(answer) < _HEAD.size or _HEAD.unpack_from(answer)[1] != _NEWLINK:
        return None
    message = ifinfmsg(answer)
    message.decode()
    linked = message.get_attr("IFLA_LINKINFO")
    kind = linked.get_attr("IFLA_INFO_KIND") if linked is not None else None
    data = linked.get_attr("IFLA_INFO_DATA") if kind == "can" else None

    def attribute(name: str, part: str = "") -> int:
        value = data.get_attr(name) if data is not None else None
        return int(value[part] if part else value) if value is not None else 0

    return Facts(
        int(message["index"]),
        bool(message["flags"] & _UP),
        kind or "",
        None if data is None else _STATES.get(str(data.get_attr("IFLA_CAN_STATE"))),
        attribute("IFLA_CAN_RESTART_MS"),
        attribute("IFLA_CAN_BITTIMING", "bitrate"),
        attribute("IFLA_CAN_DATA_BITTIMING", "bitrate"),
        int(message.get_attr("IFLA_TXQLEN") or 0),
    )


def advice(channel: str, found: Facts, bitrate: int = 0, data_bitrate: int = 0) -> list[str]:
    """Settings that harm the gateway, each with the command that corrects it.

    bitrate, data_bitrate: as configured for the gateway, bit/s; 0: not configured. Empty for links
    without a controller, which have none of these settings.
    """
    if found.kind != "can":
        return []
    setting = f"ip link set {channel} down; ip link set {channel} type can"
    lines = []
    if not found.restart_ms:
        lines.append(
            f"{channel}: restart-ms is 0: after a bus-off it stays off until somebody restarts it; "
            f"{setting} restart-ms {RESTART_MS}; ip link set {channel} up (serial adapters cannot)"
        )
    if found.queue > LONGEST_QUEUE:
        lines.append(
            f"{channel}: {found.queue} frames of others may wait before ours (txqueuelen); "
            f"ip link set {channel} txqueuelen 10"
        )
    for what, expected, real in (
        ("bitrate", bitrate, found.bitrate),
        ("dbitrate", data_bitrate, found.data_bitrate),
    ):
        if expected and real and expected != real:
            lines.append(
                f"{channel}: {what} is {real}, the gateway is configured for {expected}; "
                f"{setting} {what} {expected}; ip link set {channel} up"
            )
    return lines


class Links:
    """Requests the state of one link, periodically, in a thread of its own."""

    def __init__(
        self,
        channel: str,
        bitrate: int = 0,
        data_bitrate: int = 0,
        clock: Callable[[], Nanos] = time.monotonic_ns,
    ) -> None:
        """Send no request before `start`. bitrate, data_bitrate: see `advice`."""
        self._channel = channel
        self._bit_rates = (bitrate, data_bitrate)
        self._question = question(channel)
        self._clock = clock
        self._wake = threading.Event()
        self._ending = False
        self._thread: threading.Thread | None = None
        self._found: tuple[Nanos, bytes] = (0, b"")
        self._seen: tuple[Nanos, bytes] = (0, b"")
        self._facts: Facts | None = None
        self._advice: list[str] = []

    def start(self) -> bool:
        """Query once, then continue in the thread. False where netlink is not allowed."""
        if self._thread is not None:
            return True
        try:
            route = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
            route.settimeout(PATIENCE_S)
            self._ask(route)
        except OSError:
            return False
        self.news()  # loads pyroute2 now, not within a tick
        self._thread = threading.Thread(
            target=self._watch, args=(route,), daemon=True, name="links"
        )
        self._thread.start()
        return True

    def hurry(self) -> None:
        """Ask at once: something has changed."""
        self._wake.set()

    def news(self) -> tuple[Nanos, Facts | None]:
        """Time of the newest answered request, and the answer (None: no such link)."""
        found = self._found
        if found[1] != self._seen[1]:
            self._facts = facts(found[1])
        self._seen = found
        return found[0], self._facts

    def advice(self) -> list[str]:
        """Advice for the link as last found; empty if it is the same as in the last call."""
        if self._facts is None:
            return []
        before, self._advice = self._advice, advice(self._channel, self._facts, *self._bit_rates)
        return [] if self._advice == before else self._advice

    def close(self) -> None:
        """End the thread; if it is still waiting for the kernel, it ends by itself later."""
        self._ending = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join(PATIENCE_S)
            self._thread = None

    def _ask(self, route: socket.socket) -> None:
        asked = self._clock()
        route.send(self._question)
        self._found = (asked, route.recv(1 << 16))

    def _watch(self, route: socket.socket) -> None:
        with route:
            while not self._ending:
                self._wake.wait(ASK_NS / SECOND)
                self._wake.clear()
                with contextlib.suppress(OSError):  # then the last answer stays and ages
                    self._ask(route)
