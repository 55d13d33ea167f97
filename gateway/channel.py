"""One received message of one drive: what it is, its age, and why it is not believed.

The compiled loops work on arrays with a row per channel (`ChannelState`); a `Channel` shows one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from dbc.spec import MessageSpec
from gateway.health import Reason

Ints = NDArray[np.int64]

SAMPLE_NS: Final[Nanos] = 125_000
"""Spacing of the eight samples in a FD frame, and the filters' sub-step."""

GUARD_NS: Final[Nanos] = SECOND
"""After the last sign of a second sender nothing of that message is believed for so long."""
SECOND_SENDER: Final = 3
"""Signs of it, each within `GUARD_NS` of the one before. A controller may repeat one frame."""
TOO_SOON: Final = 0.75
"""Of the period. Of two senders of one message one always speaks so soon after the other; what is
out of sequence because frames were lost comes late."""

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

    Against a second sender: period_ns; fouls: frames out of sequence that came too soon after
    another, foul_ns the last of them; guarded_ns: until then nothing is believed.
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
    n = len(channels)
    heard, last, good, foul, guarded = (np.full(n, -1, dtype=np.int64) for _ in range(5))
    cause, blame = (np.full(n, Reason.NONE, dtype=np.int64) for _ in range(2))
    reason = np.full(n, Reason.STARTING, dtype=np.int64)
    limit = np.array([channel.limit_ns for channel in channels], dtype=np.int64).reshape(n)
    period = np.array([channel.period_ns for channel in channels], dtype=np.int64).reshape(n)
    state = ChannelState(
        heard, last, good, cause, blame, reason, np.zeros(n, dtype=np.bool_), limit, period,
        np.zeros(n, dtype=np.int64), foul, guarded,
    )  # fmt: skip
    for row, channel in enumerate(channels):
        channel.seat(row, state)
    return state
