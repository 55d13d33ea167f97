"""The only access to a bus: a small protocol, its status, and the transmit allow-list.

After `open()` no method raises for any fault of the bus: faults become states and counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Protocol, Self

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, SECOND, Frame, Nanos
from dbc.frames import Block
from dbc.spec import EXTENDED_KEY
from gateway.core.supervision import EMCY_ID, HEARTBEAT_ID
from gateway.io.wire import BusState, bus_state
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.codec import Codec

RETRY_NS: Nanos = SECOND // 2
"""Pause between two attempts to open an interface that is not there."""

NMT_ID = 0x000


class LinkState(StrEnum):
    """What is known of the interface."""

    UP = "up"
    DOWN = "down"
    ABSENT = "absent"


class SendResult(Enum):
    """What became of a frame handed to `send`. Only SENT was accepted by the kernel or device."""

    SENT = "sent"
    REFUSED = "refused"
    """Not on the allow-list; never sent."""
    FULL = "full"
    """Transmit queue full; the frame is dropped, the next one carries newer values."""
    DOWN = "down"
    """Interface down, absent or bus-off."""
    LATE = "late"
    """Its values were decided too long ago when it could be sent; never handed over."""
    FAILED = "failed"
    """Refused by the kernel or device for another reason (such as FD on a classic link)."""


@dataclass(slots=True)
class Status:
    """State and counters of a transport since it was made; updated in place."""

    state: LinkState = LinkState.ABSENT
    bus_state: BusState = BusState.ACTIVE
    received: int = 0
    sent: int = 0
    kernel_drops: int = 0
    """Frames the kernel dropped because nobody read in time."""
    malformed: int = 0
    """Reads that are neither classic CAN nor CAN FD."""
    error_frames: int = 0
    bus_offs: int = 0
    tx_refused: int = 0
    tx_full: int = 0
    tx_down: int = 0
    tx_failed: int = 0
    tx_late: int = 0
    reopened: int = 0
    """Times the interface was opened again after the first success."""
    hears_itself: bool = False
    """Whether the interface receives the frames that it sends."""
    silent: bool = False
    """Whether nothing at all may be sent."""
    note: str = ""
    """The last problem in one line, for a person."""

    def count(self, result: SendResult) -> SendResult:
        """Count a send and pass its result on."""
        name = "sent" if result is SendResult.SENT else f"tx_{result.value}"
        setattr(self, name, getattr(self, name) + 1)
        return result

    def saw(self, frame: Frame, *, from_wire: bool = True) -> None:
        """Count a received frame; an error frame updates `bus_state`.

        from_wire: a data frame ends bus-off, for interfaces with no other source of the bus state.
        """
        self.received += 1
        if frame.flags & ERROR:
            self.error_frames += 1
            self.bus_state = bus_state(frame, self.bus_state)
        elif from_wire and self.bus_state is BusState.BUS_OFF:
            self.bus_state = BusState.ACTIVE


class Transport(Protocol):
    """A bus that never raises, never blocks and never retries."""

    status: Status

    def open(self) -> None:
        """Try to open; an absent interface is tolerated and tried again while receiving.

        Raises ConfigError only for what no waiting cures: an unknown interface or option.
        """

    def receive(self) -> Block:
        """All frames that are waiting, oldest first.

        `t_ns` is the time of reception on CLOCK_MONOTONIC, never later than now.
        """

    def send(self, frame: Frame) -> SendResult:
        """Hand one frame over without blocking."""

    def close(self) -> None:
        """Give the interface back; may be called twice."""


def monotonic_stamp(stamp_ns: Nanos, real_ns: Nanos, now_ns: Nanos, bound_ns: Nanos) -> Nanos:
    """Reception time on the monotonic clock from a wall-clock stamp.

    `real_ns` and `now_ns` are the two clocks, read one after the other; `bound_ns` is the greatest
    age that the frame can have (time since the queue was last found empty). So a wall clock that
    steps, or a device with an epoch of its own, cannot move a stamp out of the time from then until
    now.
    """
    return now_ns - min(max(real_ns - stamp_ns, 0), bound_ns)


class Allow:
    """Transmit allow-list by identifier, length, format and channel; of NMT only node starts."""

    def __init__(
        self,
        lengths: Mapping[int, tuple[int, bool]],
        started: Iterable[int] = (),
        channels: Iterable[str] | None = None,
    ) -> None:
        """Take `lengths` as id (bit 31: extended) -> (data length, is FD).

        `started`: nodes that an NMT start may address, never 0 (ValueError, as for an NMT
        identifier in `lengths`); `channels`: those that may be sent on, None for any.
        """
        self.channels = None if channels is None else tuple(channels)
        self._lengths = dict(lengths)
        self._starts = frozenset(bytes((1, node)) for node in started)
        if NMT_ID in self._lengths or bytes((1, 0)) in self._starts:
            raise ValueError("NMT is allowed by node number only, and never to node 0 (broadcast)")

    @classmethod
    def from_codec(
        cls,
        codec: Codec,
        nodes: Iterable[int],
        *,
        nmt_master: bool = False,
        authenticated: bool = False,
        creep: bool = False,
        channels: Iterable[str] | None = None,
    ) -> Self:
        """Allow the gateway's own messages for the configured drives, its heartbeat and its EMCY.

        `Gateway_Auth` is allowed only with `authenticated`, optional messages only with `creep`.
        """
        nodes = frozenset(nodes)
        lengths = {
            spec.key: (spec.length, spec.is_fd)
            for spec in codec.own(creep=creep)
            if (spec.node == 0 or spec.node in nodes) and (authenticated or spec.kind != "Auth")
        }
        lengths[HEARTBEAT_ID] = (1, False)
        lengths[EMCY_ID] = (8, False)
        return cls(lengths, nodes if nmt_master else (), channels)

    @property
    def silent(self) -> bool:
        """Whether nothing at all may be sent: then a refusal is not worth reporting."""
        return not self._lengths and not self._starts

    def check_channel(self, channel: str) -> None:
        """Raises ConfigError if frames could be sent on a channel that is not listed."""
        if not self.silent and self.channels is not None and channel not in self.channels:
            named = ", ".join(self.channels) or "none"
            raise ConfigError(
                f"channel {channel}",
                [f"[bus] send_on allows {named}; name that one, or run with --listen-only"],
            )

    def permits(self, frame: Frame) -> bool:
        """Whether this frame may be sent."""
        if frame.flags & (REMOTE | ERROR):
            return False
        key = frame.can_id | (EXTENDED_KEY if frame.flags & EXTENDED else 0)
        if key == NMT_ID:
            return not frame.flags & FD and frame.data in self._starts
        return self._lengths.get(key) == (len(frame.data), frame.is_fd)


class Guarded:
    """A transport behind an allow-list: anything else is refused and counted, never raised."""

    def __init__(self, inner: Transport, allow: Allow, channel: str = "") -> None:
        """Wrap `inner`, which is on `channel`; its status is shared.

        Raises ConfigError for a channel on which nothing may be sent.
        """
        allow.check_channel(channel)
        self._channels = ("", channel)
        self._inner = inner
        self._allow = allow
        self.status = inner.status
        self.status.silent = allow.silent

    def open(self) -> None:
        """See Transport."""
        self._inner.open()

    def receive(self) -> Block:
        """See Transport."""
        return self._inner.receive()

    def send(self, frame: Frame) -> SendResult:
        """Send if allowed, else REFUSED."""
        if not self._allow.permits(frame) or frame.channel not in self._channels:
            if not self._allow.silent:
                self.status.note = f"refused to send {frame.can_id:03X}#{frame.data.hex().upper()}"
            return self.status.count(SendResult.REFUSED)
        return self._inner.send(frame)

    def close(self) -> None:
        """See Transport."""
        self._inner.close()
