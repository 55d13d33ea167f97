"""The receiver: records and room for what `gateway/core/receive.c` does with a tick's frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import Nanos
from dbc.frames import MAX_DATA_BYTES
from dbc.records import ID_ENTRY, RECEIVER, Addressed, Records
from gateway.core import pairing
from gateway.core.supervision import Supervision

Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]


class Tally(IntEnum):
    """Counters of frames; their lower-case names are those of `Inbox.counts`."""

    DECODED = lib.RX_DECODED
    ERROR_FRAME = lib.RX_ERROR_FRAME
    REMOTE = lib.RX_REMOTE
    OWN = lib.RX_OWN
    TIME_BACK = lib.RX_TIME_BACK
    WRONG_LENGTH = lib.RX_WRONG_LENGTH
    ERROR = lib.RX_ERROR
    REPEATED = lib.RX_REPEATED
    WRONG_SEQUENCE = lib.RX_WRONG_SEQUENCE
    LOST = lib.RX_LOST
    NOT_YET_VALID = lib.RX_NOT_YET_VALID
    NOT_AVAILABLE = lib.RX_NOT_AVAILABLE
    RANGE = lib.RX_RANGE
    UNKNOWN_ID = lib.RX_UNKNOWN_ID
    CANOPEN = lib.RX_CANOPEN


NAMES: Final = tuple(tally.name.lower() for tally in Tally)


class Scratch(NamedTuple):
    """Accepted frames of a tick, decoded, (R,); `seen`: which of them have temperatures."""

    channel: Ints
    message: NDArray[np.int32]
    t_ns: Ints
    payload: Bytes
    value: NDArray[np.float64]
    validity: Bytes
    seen: Ints
    foreign: Ints


class Receiver(Addressed):
    """A `struct receiver` with everything that it points to. A copy is a receiver of its own."""

    tick: Records
    counters: Ints
    pointer: Any

    def __init__(
        self, codec: Codec, channels: Records, drives: int, ids: Mapping[int, int],
        supervision: Supervision, max_gap_ns: Nanos,
    ) -> None:  # fmt: skip
        """ids: by key (`MessageSpec.key`) the index of a channel, or `enum id_owner`."""
        self.codec, self.supervision = codec, supervision
        self.channels, self.drives = channels, pairing.drive_inputs(drives)
        self.ids = np.array(sorted(ids.items()), ID_ENTRY)
        self.record = np.zeros(1, RECEIVER)
        self.record["max_gap_ns"] = max_gap_ns
        self.record["standard_ids"] = [ids.get(k, lib.ID_UNKNOWN) for k in range(lib.STANDARD_IDS)]
        self.reserve(64)

    @property
    def rows(self) -> int:
        """Frames of a tick that there is room for."""
        return len(self.scratch.t_ns)

    def reserve(self, rows: int) -> None:
        """For so many frames of a tick."""
        self.workspace, self.readings = pairing.workspace(rows), pairing.readings(rows)
        self.before = np.zeros_like(self.workspace.gap)
        self.scratch = Scratch(
            channel=np.zeros(rows, dtype=np.int64),
            message=np.zeros(rows, dtype=np.int32),
            t_ns=np.zeros(rows, dtype=np.int64),
            payload=np.zeros((rows, MAX_DATA_BYTES), dtype=np.uint8),
            value=np.zeros((rows, self.codec.width)),
            validity=np.zeros((rows, self.codec.width), dtype=np.uint8),
            seen=np.zeros(rows, dtype=np.int64),
            foreign=np.zeros(rows, dtype=np.int64),
        )
        self.link()

    def link(self) -> None:
        """Addresses in the record, and columns of records."""
        s, m, r = self.scratch, self.workspace, self.readings
        arrays = {
            "channels": self.channels, "drives": self.drives, "ids": self.ids,
            "channel": s.channel, "message": s.message, "t_ns": s.t_ns, "payload": s.payload,
            "value": s.value, "validity": s.validity, "temperature_rows": s.seen,
            "emergency_rows": s.foreign, "sample_drive": m.drive, "sample_u": m.u, "sample_y": m.y,
            "sample_steps": m.steps, "sample_gap": m.gap,
            "sample_before": self.before, "motion_drive": r.drive,
            "motion_t_ns": r.t_ns, "motion_speed": r.speed, "motion_torque": r.torque,
            "motion_angle": r.angle,
        }  # fmt: skip
        for name, array in arrays.items():
            self.record[name] = array.ctypes.data
        self.record["codec"] = self.codec.tables.address
        self.record["supervision"] = self.supervision.address
        for name, held in (("channel", self.channels), ("drive", self.drives), ("id", self.ids)):
            self.record[f"{name}_count"] = len(held)
        self.pointer = ffi.from_buffer("struct receiver *", self.record)
        self.tick, self.counters = self.record["tick"], self.record["counters"][0]


def id_table(
    channels: Mapping[int, int], own: Iterable[int], supervised: Iterable[int]
) -> dict[int, int]:
    """From key to channel; keys that are the gateway's own; those of heartbeats and emergencies."""
    return {
        **dict.fromkeys(supervised, lib.ID_SUPERVISED), **channels,
        **dict.fromkeys(own, lib.ID_OWN),
    }  # fmt: skip
