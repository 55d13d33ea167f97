"""The receiver: records and workspace of `gateway/core/receive.c`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any, Final

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.arrays import Ints
from dbc.codec import Codec
from dbc.frame import Nanos
from dbc.frames import MAX_DATA_BYTES
from dbc.records import DRIVE_INPUT, ID_ENTRY, RECEIVER, Addressed, Records, point_to
from gateway.core.supervision import Supervision


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


SAMPLES_OF_A_FRAME: Final = 8
_OF_A_FRAME: Final[dict[str, tuple[Any, ...]]] = {
    "channel": (np.int64,), "message": (np.int32,), "t_ns": (np.int64,),
    "payload": (np.uint8, MAX_DATA_BYTES),
    "temperature_rows": (np.int64,), "emergency_rows": (np.int64,),
    "motion_drive": (np.int64,), "motion_t_ns": (np.int64,), "motion_speed": (np.float64,),
    "motion_torque": (np.float64,), "motion_angle": (np.float64,),
}  # fmt: skip
_OF_A_SAMPLE: Final[dict[str, tuple[Any, ...]]] = {
    "sample_drive": (np.int32,), "sample_u": (np.float64, 2), "sample_y": (np.float64, 2),
    "sample_steps": (np.int64,), "sample_gap": (np.int64,), "sample_before": (np.int64,),
}  # fmt: skip
"""Columns that `struct receiver` points to (their units are there): type, second dimension."""


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
        self.channels, self.drives = channels, drive_inputs(drives)
        self.ids = np.array(sorted(ids.items()), ID_ENTRY)
        self.record = np.zeros(1, RECEIVER)
        self.record["max_gap_ns"] = max_gap_ns
        self.record["standard_ids"] = [ids.get(k, lib.ID_UNKNOWN) for k in range(lib.STANDARD_IDS)]
        self.reserve(64)

    @property
    def rows(self) -> int:
        """Frames of a tick that there is room for."""
        return len(self.space["t_ns"])

    @property
    def sample_rows(self) -> int:
        """Samples of a tick that there is room for."""
        return SAMPLES_OF_A_FRAME * self.rows

    def reserve(self, rows: int) -> None:
        """Make room for so many frames per tick."""
        width = self.codec.width
        each = _OF_A_FRAME | {"value": (np.float64, width), "validity": (np.uint8, width)}
        self.space = {
            **{name: _column(rows, *form) for name, form in each.items()},
            **{name: _column(SAMPLES_OF_A_FRAME * rows, *form)
               for name, form in _OF_A_SAMPLE.items()},
        }  # fmt: skip
        """Arrays by their names in `struct receiver`."""
        self.link()

    def link(self) -> None:
        """Put addresses into the record, and take views of its columns."""
        held = {"channels": self.channels, "drives": self.drives, "ids": self.ids}
        point_to(self.record, self.space | held)
        self.record["codec"] = self.codec.tables.address
        self.record["supervision"] = self.supervision.address
        for name, array in held.items():
            self.record[f"{name.removesuffix('s')}_count"] = len(array)
        self.pointer = ffi.from_buffer("struct receiver *", self.record)
        self.tick, self.counters = self.record["tick"], self.record["counters"][0]


def _column(rows: int, kind: Any, *numbers: int) -> NDArray[Any]:
    return np.zeros((rows, *numbers), kind)


def drive_inputs(drives: int) -> Records:
    """(N,) of `struct drive_input`: drives from which nothing has been received."""
    found = np.zeros(drives, DRIVE_INPUT)
    found["pending"]["t_ns"] = -1
    found["sample_ns"] = found["newest_sample"] = found["emergency_ns"] = -1
    for name in ("speed", "command", "previous_command", "irms"):
        found[name] = np.nan
    found["operating"] = found["command_steady"] = 1
    return found


def id_table(
    channels: Mapping[int, int], own: Iterable[int], supervised: Iterable[int]
) -> dict[int, int]:
    """Owner by key: index of a channel, `ID_OWN`, or `ID_SUPERVISED` (heartbeat, emergency)."""
    return {
        **dict.fromkeys(supervised, lib.ID_SUPERVISED), **channels,
        **dict.fromkeys(own, lib.ID_OWN),
    }  # fmt: skip
