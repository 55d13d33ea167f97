"""One received message of one drive: what it is, its age, and why it is not believed.

The compiled loops work on arrays with a row per channel (`ChannelState`); a `Channel` shows one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.block import ROOM
from dbc.frame import SECOND, Nanos
from dbc.spec import MessageSpec
from gateway.health import Reason

Ints = NDArray[np.int64]

SAMPLE_NS: Final[Nanos] = 125_000
"""Spacing of the eight samples in a FD frame, and the filters' sub-step."""

GUARD_NS: Final[Nanos] = SECOND
"""After the last sign of a second sender no frame of that message is used for so long."""
SECOND_SENDER: Final = 3
"""Signs of it, each within `GUARD_NS` of the one before. A restart of the sender is one."""
TOO_SOON: Final = 0.75
"""Of the time that a counter's steps take, one period each. Of two senders at least one counter a
period jumps ahead, or stands still, sooner; what jumps because frames were lost comes late."""
COPIES: Final = 6
"""Sum at which identical frames are a sign: each repeated one adds 2, each new one takes 1 away. So
five in a row, or two senders in step with equal values; not a controller that repeats some."""

# The signals the gateway uses of each kind, in the order in which the inbox takes them. Mapped
# inverters have no `ElectricalAngle` and no `State`.
USED: Final = {
    "PhaseCurrents": ("Ia", "Ib", "Ic"),
    "StatorVoltages": ("Ualpha", "Ubeta"),
    "Samples": (
        "SampleIndex",
        *(f"{name}_{k}" for k in range(8) for name in ("Ia", "Ib", "Ualpha", "Ubeta")),
    ),
    "Motion": ("Speed", "Torque", "ElectricalAngle"),
    "Status": ("TorqueCommand", "Irms", "State"),
    "Temperatures": ("Tstator", "Tde", "Tnde", "Tambient"),
}


class ChannelState(NamedTuple):
    """Memory of the receive loop, a row per channel; stamps are -1 where there is none.

    heard_ns: any frame of ours; last_ns: one with good protection; good_ns: one whose values
    could be used; cause: why the last values could not be (Reason); blame: what last went wrong
    in the protection; reason: why the channel is not believed now; seen_valid: it once was.

    Against a second sender: period_ns; counted_ns: stamp of the frame that the next counter is
    compared with, latest (C, 64) its bytes; copies: see `COPIES`; fouls: signs, foul_ns the last
    of them; guarded_ns: until then no frame is used.
    """

    heard_ns: Ints
    last_ns: Ints
    good_ns: Ints
    cause: Ints
    blame: Ints
    reason: Ints
    seen_valid: NDArray[np.bool_]
    limit_ns: Ints
    period_ns: Ints
    counted_ns: Ints
    latest: NDArray[np.uint8]
    copies: Ints
    fouls: Ints
    foul_ns: Ints
    guarded_ns: Ints


class Channel:
    """Constants of one message, and its row of the state."""

    __slots__ = (
        "_memory", "drive", "index", "kind", "limit_ns", "period_ns", "picked", "quality", "row",
        "spec", "steps",
    )  # fmt: skip

    def __init__(self, spec: MessageSpec, drive: int, tick_ns: Nanos) -> None:
        """drive: position in the configuration; the age limit is three periods and a tick."""
        columns = {signal.name: k for k, signal in enumerate(spec.signals)}
        self.spec = spec
        self.drive = drive
        self.kind = spec.kind
        self.period_ns = spec.cycle_ns
        self.limit_ns = 3 * spec.cycle_ns + tick_ns
        self.index = spec.index
        self.steps = max(1, round(spec.cycle_ns / SAMPLE_NS))
        self.quality = columns.get("Quality", -1)
        self.picked = tuple(columns[name] for name in USED[spec.kind] if name in columns)

    def seat(self, row: int, memory: ChannelState) -> None:
        """Where its state is kept."""
        self.row, self._memory = row, memory

    @property
    def good_ns(self) -> Nanos:
        """Stamp of the last good value; -1 before any."""
        return self._memory.good_ns.item(self.row)

    @property
    def state(self) -> Reason:
        """Why it is not believed; NONE if it is."""
        return Reason(self._memory.reason.item(self.row))

    @property
    def seen_valid(self) -> bool:
        """Whether it ever was valid."""
        return self._memory.seen_valid.item(self.row)

    def fresh(self, now: Nanos) -> bool:
        """True while the last good value is within the age limit and can be believed."""
        good = self.good_ns
        return good >= 0 and now - good <= self.limit_ns and self.state is Reason.NONE


def channel_state(channels: Sequence[Channel]) -> ChannelState:
    """Nothing received yet; each channel is given its row."""
    limits, periods = [c.limit_ns for c in channels], [c.period_ns for c in channels]
    state = blank_state(limits, periods)
    for row, channel in enumerate(channels):
        channel.seat(row, state)
    return state


def blank_state(limits_ns: Sequence[Nanos], periods_ns: Sequence[Nanos]) -> ChannelState:
    """State of so many channels before their first frame."""
    n = len(limits_ns)
    heard, last, good, counted, foul, guarded = (np.full(n, -1, dtype=np.int64) for _ in range(6))
    cause, blame = (np.full(n, Reason.NONE, dtype=np.int64) for _ in range(2))
    reason = np.full(n, Reason.STARTING, dtype=np.int64)
    limit = np.array(limits_ns, dtype=np.int64).reshape(n)
    period = np.array(periods_ns, dtype=np.int64).reshape(n)
    latest, (copies, fouls) = np.zeros((n, ROOM), dtype=np.uint8), np.zeros((2, n), dtype=np.int64)
    return ChannelState(
        heard, last, good, cause, blame, reason, np.zeros(n, dtype=np.bool_), limit, period,
        counted, latest, copies, fouls, foul, guarded,
    )  # fmt: skip
