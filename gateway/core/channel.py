"""One received message of one drive: what it is, its age, and why it is unknown.

The records are `struct channel` (gateway/core/records.h), one per message; the rules by which they
change are in `gateway/core/receive.c`. A `Channel` shows one.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple, Protocol

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc import e2e
from dbc.frame import Nanos
from dbc.records import CHANNEL, SEQUENCE_GUARD, Records, pointer
from dbc.spec import MessageSpec
from gateway.core.codes import Reason

Ints = NDArray[np.int64]

SAMPLE_NS: Final[Nanos] = 125_000
"""Spacing of the eight samples in a FD frame, and the filters' sub-step."""
SHORTEST_STEP: Final = 0.75
"""Share of its period in which a counter step is a sign of a second sender."""

# The signals the gateway uses of each kind, in the order in which they are received. Mapped
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


class Kind(IntEnum):
    """What a channel carries; the first three become samples."""

    CURRENTS = lib.KIND_CURRENTS
    VOLTAGES = lib.KIND_VOLTAGES
    BLOCK = lib.KIND_BLOCK
    MOTION = lib.KIND_MOTION
    TEMPERATURES = lib.KIND_TEMPERATURES
    STATUS = lib.KIND_STATUS


_KINDS: Final = {
    "PhaseCurrents": Kind.CURRENTS,
    "StatorVoltages": Kind.VOLTAGES,
    "Samples": Kind.BLOCK,
    "Motion": Kind.MOTION,
    "Temperatures": Kind.TEMPERATURES,
    "Status": Kind.STATUS,
}


class ChannelState(NamedTuple):
    """Columns of the records that compiled loops read, (C,); stamps are -1 where there is none.

    heard_ns: any frame; good_ns: one whose values could be used; reason: why the channel is unknown
    now (`Reason`); seen_valid: its receiver was once valid; limit_ns: age limit.
    """

    heard_ns: Ints
    good_ns: Ints
    reason: NDArray[np.uint8]
    seen_valid: NDArray[np.bool_]
    limit_ns: Ints


class HasState(Protocol):
    """Whoever holds the records: `receiving.Receiver`."""

    state: ChannelState
    channels: Records


class Channel:
    """Constants of one message, and its record."""

    __slots__ = (
        "_receiver", "drive", "index", "kind", "limit_ns", "period_ns", "picked", "quality", "row",
        "spec", "steps",
    )  # fmt: skip

    def __init__(self, spec: MessageSpec, drive: int, tick_ns: Nanos) -> None:
        """drive: position in the configuration; the age limit is three periods and a tick."""
        columns = {signal.name: k for k, signal in enumerate(spec.signals)}
        self.spec = spec
        self.drive = drive
        self.kind = spec.kind
        self.period_ns = max(spec.cycle_ns, 1)
        self.limit_ns = 3 * spec.cycle_ns + tick_ns
        self.index = spec.index
        self.steps = max(1, round(spec.cycle_ns / SAMPLE_NS))
        self.quality = columns.get("Quality", -1)
        self.picked = tuple(columns[name] for name in USED[spec.kind] if name in columns)

    def seat(self, row: int, receiver: HasState) -> None:
        """Where its record is kept."""
        self.row, self._receiver = row, receiver

    @property
    def good_ns(self) -> Nanos:
        """Stamp of the last good value; -1 before any."""
        return self._receiver.state.good_ns.item(self.row)

    @property
    def state(self) -> Reason:
        """Why it is unknown; NONE if it is not."""
        return Reason(self._receiver.state.reason.item(self.row))

    @property
    def seen_valid(self) -> bool:
        """Whether it ever was valid."""
        return self._receiver.state.seen_valid.item(self.row)

    def fresh(self, now: Nanos) -> bool:
        """True while the last good value is within the age limit and the channel is known."""
        record = pointer("struct channel", self._receiver.channels) + self.row
        return bool(lib.is_channel_fresh(record, now))


def records(channels: Sequence[Channel]) -> Records:
    """Of these channels, (C,) of `struct channel`; nothing received yet."""
    found = np.zeros(len(channels), CHANNEL)
    found["e2e_config"] = e2e.configs([channel.spec for channel in channels])
    found["e2e_state"] = e2e.states(len(channels))
    for name in ("received_ns", "accepted_ns", "good_ns"):
        found[name] = -1
    found["guard"] = sequence_guards([channel.spec.cycle_ns for channel in channels])
    found["reason"] = Reason.STARTING
    for row, channel in zip(found, channels, strict=True):
        row["period_ns"], row["limit_ns"] = channel.period_ns, channel.limit_ns
        row["message"], row["drive"] = channel.index, channel.drive
        row["signal_count"], row["quality"] = len(channel.spec.signals), channel.quality
        row["steps"], row["kind"] = channel.steps, _KINDS[channel.kind]
        row["column_count"] = len(channel.picked)
        row["columns"][: len(channel.picked)] = channel.picked
    return found


def sequence_guards(periods_ns: Sequence[Nanos]) -> Records:
    """Of messages with these periods, (C,) of `struct sequence_guard`; nothing received yet."""
    found = np.zeros(len(periods_ns), SEQUENCE_GUARD)
    found["shortest_step_ns"] = SHORTEST_STEP * np.array(periods_ns, dtype=np.float64)
    for name in ("counter_ns", "error_ns", "rejected_until_ns"):
        found[name] = -1
    return found


def state_of(channels: Records) -> ChannelState:
    """Columns of these records."""
    return ChannelState(
        channels["received_ns"], channels["good_ns"], channels["reason"],
        channels["was_valid"].view(np.bool_), channels["limit_ns"],
    )  # fmt: skip
