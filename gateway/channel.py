"""One received message of one drive: what it is, its age, and why it is not believed.

The compiled receive loop works on arrays with a row per channel (`ChannelState`); after every
tick each `Channel` is told what the rest of the core asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from dbc.protection import Profile
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

# The signals the gateway uses of each kind, in the order in which the inbox takes them.
USED: Final = {
    "PhaseCurrents": ("Ia", "Ib", "Ic"),
    "StatorVoltages": ("Ualpha", "Ubeta"),
    "Samples": (
        "SampleIndex",
        *(f"{name}_{k}" for k in range(8) for name in ("Ia", "Ib", "Ualpha", "Ubeta")),
    ),
    "Motion": ("Speed", "Torque"),
    "Status": ("TorqueCommand", "Irms"),
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
    """Constants of one message, and its state as of the last tick."""

    __slots__ = (
        "drive", "good_ns", "heard", "index", "kind", "limit_ns", "period_ns", "picked",
        "protected", "quality", "seen_valid", "spec", "state", "steps",
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
        self.protected = spec.profile is not Profile.NONE
        self.quality = columns.get("Quality", -1)
        self.picked = tuple(columns[name] for name in USED[spec.kind] if name in columns)
        self.good_ns: Nanos = -1
        self.state = Reason.STARTING
        self.heard = False
        self.seen_valid = False

    def fresh(self, now: Nanos) -> bool:
        """True while the last good value is within the age limit and can be believed."""
        good = self.good_ns
        return good >= 0 and now - good <= self.limit_ns and self.state is Reason.NONE


def channel_state(channels: Sequence[Channel]) -> ChannelState:
    """Nothing received yet."""
    n = len(channels)
    heard, last, good, foul, guarded = (np.full(n, -1, dtype=np.int64) for _ in range(5))
    cause, blame = (np.full(n, Reason.NONE, dtype=np.int64) for _ in range(2))
    reason = np.full(n, Reason.STARTING, dtype=np.int64)
    limit = np.array([channel.limit_ns for channel in channels], dtype=np.int64).reshape(n)
    period = np.array([channel.period_ns for channel in channels], dtype=np.int64).reshape(n)
    return ChannelState(
        heard, last, good, cause, blame, reason, np.zeros(n, dtype=np.bool_), limit, period,
        np.zeros(n, dtype=np.int64), foul, guarded,
    )  # fmt: skip


def tell(channels: Sequence[Channel], state: ChannelState) -> None:
    """Give every channel its state as of this tick."""
    rows = zip(
        channels, state.reason.tolist(), state.good_ns.tolist(), state.seen_valid.tolist(),
        state.heard_ns.tolist(), strict=True,
    )  # fmt: skip
    for channel, reason, good_ns, seen_valid, heard_ns in rows:
        channel.state = _REASONS[reason]
        channel.good_ns = good_ns
        channel.heard = heard_ns >= 0
        channel.seen_valid = seen_valid


_REASONS: Final = {int(reason): reason for reason in Reason}
