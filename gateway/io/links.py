"""State and settings of a CAN link, as the kernel reports them over netlink.

Error frames tell of a change once, and may be lost, or may not be sent at all; this is the second
witness, and it knows what no frame says: `restart-ms`, bit rates, the length of the queue.

The kernel answers under a lock that whoever sets up any link holds for as long as that takes. So a
thread asks, and the loop only looks at what it has found: two system calls of 3 us there, and here
0.1 ms to take an answer apart (by pyroute2) that differs from the one before.
Nothing is ever changed by netlink here. Formats: rtnetlink(7), linux/can/netlink.h.
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
"""Pause between two questions, unless somebody has a reason to ask at once."""
PATIENCE_S: Final = 1.0
LONGEST_QUEUE: Final = 100
"""Frames. The kernel's own length for a CAN controller is 10."""
RESTART_MS: Final = 100
"""What the advice says: long enough not to take the bus from others."""

_GETLINK, _NEWLINK, _REQUEST = 18, 16, 1
_IFNAME, _EXT_MASK, _SKIP_STATS = 3, 29, 8
_HEAD, _BODY, _ATTRIBUTE = struct.Struct("=IHHII"), struct.Struct("=BxHiII"), struct.Struct("=HH")
_UP, _LOWER_UP = 1, 0x10000
_STATES: Final = {
    "ERROR_ACTIVE": BusState.ACTIVE,
    "ERROR_WARNING": BusState.WARNING,
    "ERROR_PASSIVE": BusState.PASSIVE,
    "BUS_OFF": BusState.BUS_OFF,
}


class Facts(NamedTuple):
    """One answer."""

    ifindex: int
    up: bool
    carrier: bool
    kind: str
    """`can` has a controller; `vcan` and `vxcan` have none, and no bit rate."""
    state: BusState | None
    """None without a controller, and while the link is down."""
    restart_ms: int
    bitrate: int
    """bit/s; 0 if the driver does not say."""
    data_bitrate: int
    queue: int
    """Frames that may wait for the controller (`txqueuelen`)."""


def question(channel: str) -> bytes:
    """RTM_GETLINK by name, without the statistics: answers are the same until something changes."""
    name = channel.encode()[:15] + b"\0"
    body = _BODY.pack(0, 0, 0, 0, 0)
    body += _ATTRIBUTE.pack(4 + len(name), _IFNAME) + name + bytes(-len(name) % 4)
    body += _ATTRIBUTE.pack(8, _EXT_MASK) + struct.pack("=I", _SKIP_STATS)
    return _HEAD.pack(_HEAD.size + len(body), _GETLINK, _REQUEST, 1, 0) + body


def facts(answer: bytes) -> Facts | None:
    """An answer taken apart; None if it is none, such as "no such device"."""
    # Loading it takes 0.1 to 0.2 s, which only those who open SocketCAN should pay.
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
        bool(message["flags"] & _LOWER_UP),
        kind or "",
        None if data is None else _STATES.get(str(data.get_attr("IFLA_CAN_STATE"))),
        attribute("IFLA_CAN_RESTART_MS"),
        attribute("IFLA_CAN_BITTIMING", "bitrate"),
        attribute("IFLA_CAN_DATA_BITTIMING", "bitrate"),
        int(message.get_attr("IFLA_TXQLEN") or 0),
    )


def advice(channel: str, found: Facts, bitrate: int = 0, data_bitrate: int = 0) -> list[str]:
    """What is set up so that the gateway will suffer, each with the command that cures it.

    bitrate, data_bitrate: what the gateway was told, bit/s; 0 if nothing. Empty for links without
    a controller: they have none of this.
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
                f"{channel}: {what} is {real}, the gateway was told {expected}; "
                f"{setting} {what} {expected}; ip link set {channel} up"
            )
    return lines


class Links:
    """Asks for one link, now and then, in a thread of its own."""

    def __init__(
        self,
        channel: str,
        bitrate: int = 0,
        data_bitrate: int = 0,
        clock: Callable[[], Nanos] = time.monotonic_ns,
    ) -> None:
        """Nothing is asked before `start`. bitrate, data_bitrate: see `advice`."""
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
        """Ask once, then go on in the thread. False where netlink is not allowed."""
        if self._thread is not None:
            return True
        try:
            route = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
            route.settimeout(PATIENCE_S)
            self._ask(route)
        except OSError:
            return False
        self.news()  # loads the library now and not in a tick, should the link be absent
        self._thread = threading.Thread(
            target=self._watch, args=(route,), daemon=True, name="links"
        )
        self._thread.start()
        return True

    def hurry(self) -> None:
        """Ask at once: something has changed."""
        self._wake.set()

    def news(self) -> tuple[Nanos, Facts | None]:
        """When the newest answer was asked for, and what it says (None: no such link)."""
        found = self._found
        if found[1] != self._seen[1]:
            self._facts = facts(found[1])
        self._seen = found
        return found[0], self._facts

    def advice(self) -> list[str]:
        """What to change of the link as it was found, if that has not just been said."""
        if self._facts is None:
            return []
        before, self._advice = self._advice, advice(self._channel, self._facts, *self._bit_rates)
        return [] if self._advice == before else self._advice

    def close(self) -> None:
        """End the thread; should the kernel still make it wait, it ends by itself."""
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
                with contextlib.suppress(OSError):  # nothing new then: what is known gets old
                    self._ask(route)
