"""One received message of one drive: its constants, its age, and why it is unknown.

The records are `struct channel` (gateway/core/records.h), one per message; the rules by which they
change are in `gateway/core/receive.c`. A `Channel` shows one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from _traction_core import lib

from dbc import e2e
from dbc.frame import Nanos
from dbc.records import CHANNEL, SEQUENCE_GUARD, Records
from dbc.spec import MessageSpec
from gateway.core.codes import Reason

SAMPLE_NS: Final[Nanos] = 125_000
"""Spacing of the eight samples in a FD frame, and the filters' sub-step."""
RPM: Final = 2.0 * math.pi / 60.0
"""rad/s in one revolution per minute."""
SHORTEST_STEP: Final = 0.75
"""A counter step in a shorter share of its period indicates a second sender."""

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


_KINDS: Final = {
    "PhaseCurrents": lib.KIND_CURRENTS,
    "StatorVoltages": lib.KIND_VOLTAGES,
    "Samples": lib.KIND_BLOCK,
    "Motion": lib.KIND_MOTION,
    "Temperatures": lib.KIND_TEMPERATURES,
    "Status": lib.KIND_STATUS,
}
"""What a channel carries; the first three become samples."""


class Channel:
    """Constants of one message, and its record."""

    __slots__ = (
        "drive", "index", "kind", "limit_ns", "period_ns", "picked", "quality", "row",
        "spec", "steps",
    )  # fmt: skip

    def __init__(self, spec: MessageSpec, drive: int, row: int, tick_ns: Nanos) -> None:
        """drive: position in the configuration; row: of its record.

        The age limit is three periods and a tick.
        """
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
        self.row = row


def records(channels: Sequence[Channel]) -> Records:
    """`struct channel` of these channels, (C,); nothing received yet."""
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
    """`struct sequence_guard` of messages with these periods, (C,); nothing received yet."""
    found = np.zeros(len(periods_ns), SEQUENCE_GUARD)
    found["shortest_step_ns"] = SHORTEST_STEP * np.array(periods_ns, dtype=np.float64)
    for name in ("counter_ns", "error_ns", "rejected_until_ns"):
        found[name] = -1
    return found
