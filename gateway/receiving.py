"""What the compiled receive loop reads and writes besides channels and pairs.

`Routes` says which identifier is whose; `Scratch` is room for one tick, `Tally` its counters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.block import ROOM

Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

OWN: Final = -2
SUPERVISED: Final = -3
"""Heartbeats and emergencies of the drives' nodes, which `supervision` knows."""
NO_ROUTE: Final = -1
EXTENDED_SHIFT: Final = 31
STANDARD: Final = 1 << 11
"""Identifiers of 11 bits."""


class Tally(IntEnum):
    """Counters of the loop; their lower-case names are those of `Inbox.counts`."""

    DECODED = 0
    ERROR_FRAME = 1
    REMOTE = 2
    OWN = 3
    TIME_BACK = 4
    WRONG_LENGTH = 5
    ERROR = 6
    """Wrong checksum."""
    REPEATED = 7
    WRONG_SEQUENCE = 8
    LOST = 9
    NOT_YET_VALID = 10
    NOT_AVAILABLE = 11
    RANGE = 12
    UNKNOWN_ID = 13
    CANOPEN = 14
    """Heartbeats of the drives' nodes; their emergencies are told one by one (`foreign`)."""


NAMES: Final = tuple(tally.name.lower() for tally in Tally)


class Routes(NamedTuple):
    """Identifiers in ascending order (29-bit ones with bit 31 set), and the channel of each.

    standard (2048,): the channel of every 11-bit one.
    """

    key: Ints
    channel: Ints
    standard: Ints


class Scratch(NamedTuple):
    """Room for R frames of one tick: accepted rows, their decoded values, rows to look at."""

    channel: Ints
    message: NDArray[np.int32]
    t_ns: Ints
    payload: Bytes
    value: NDArray[np.float64]
    validity: Bytes
    verdict: Bytes
    seen: Ints
    foreign: Ints
    tally: Ints


def routes(channels: Mapping[int, int], own: Iterable[int], supervised: Iterable[int]) -> Routes:
    """From key to channel number; keys that are the gateway's own; those of heartbeats."""
    table = {**dict.fromkeys(supervised, SUPERVISED), **channels, **dict.fromkeys(own, OWN)}
    keys = sorted(table)
    standard = [table.get(key, NO_ROUTE) for key in range(STANDARD)]
    return Routes(
        np.array(keys, dtype=np.int64), np.array([table[key] for key in keys], dtype=np.int64),
        np.array(standard, dtype=np.int64),
    )  # fmt: skip


def scratch(rows: int, width: int) -> Scratch:
    """Room for `rows` frames of at most `width` signals."""
    return Scratch(
        channel=np.zeros(rows, dtype=np.int64),
        message=np.zeros(rows, dtype=np.int32),
        t_ns=np.zeros(rows, dtype=np.int64),
        payload=np.zeros((rows, ROOM), dtype=np.uint8),
        value=np.zeros((rows, width)),
        validity=np.zeros((rows, width), dtype=np.uint8),
        verdict=np.zeros(rows, dtype=np.uint8),
        seen=np.zeros(rows, dtype=np.int64),
        foreign=np.zeros(rows, dtype=np.int64),
        tally=np.zeros(len(Tally), dtype=np.int64),
    )
