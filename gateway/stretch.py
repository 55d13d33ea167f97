"""What several ticks in one call are done with: the parts of a gateway, as its own steps use them.

May know: tables of the parts. May not know: frames, clocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import Records
from gateway import sources, tracks
from gateway.channel import ChannelState
from gateway.flags import Status
from gateway.inputs import Inputs, Places
from gateway.pairing import PairState
from gateway.receiving import Scratch, Wiring
from gateway.said import Findings
from gateway.slow import SlowState
from gateway.warmth import Warmth

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]


class Receiving(NamedTuple):
    """Frames in, as `Inbox.take` and `BusLoad.add_block`; which inputs are believed.

    receiver, supervision, drive_channels, input_status: addresses of the records; tick, counters:
    parts of the receiver's.
    """

    period_ns: int
    receiver: int
    tick: Records
    counters: Ints
    state: ChannelState
    wiring: Wiring
    pairs: PairState
    slow: SlowState
    scratch: Scratch
    supervision: int
    busy_s: float
    classic_s: Array
    fd_s: Array
    drive_channels: int
    input_status: int
    places: Places


class Filtering(NamedTuple):
    """As `Bank.run` and `MotionMonitor`. estimator, motion: addresses; implausible (N,)."""

    inputs: Inputs
    estimator: int
    told: tracks.Told
    motion: int
    implausible: Bytes


class Judging(NamedTuple):
    """As `AdhesionMonitor.detect` with the detector in the core, which fills lost, known (N,).

    adhesion, drives: addresses of `struct adhesion` and of `struct drive_input` (N,).
    """

    adhesion: int
    drives: int
    lost: Array
    known: Bools
    severe: NDArray[np.uint8]
    uncertain: NDArray[np.uint8]
    rules: Records
    common_mode: Records


class Warming(NamedTuple):
    """As `ThermalSide`, of which the model has no part. limit_ns (N,): how old readings may be.

    summed: seconds are added up, none of them is complete in these ticks.
    """

    warmth: Warmth
    summed: bool
    limit_ns: Ints


class Saying(NamedTuple):
    """Flags and frames out.

    cost_s (M,): seconds that each message takes on the wire; rejected, lost: frames so far; rejects
    (T,): which of the receive loop's tallies are of rejected frames.
    """

    findings: Findings
    train_inputs: Records
    inputs: Records
    evidence: Records
    status: Status
    counts: Array
    sheet: sources.Sheet
    e2e_config: Records
    memory: sources.Memory
    room: sources.Room
    cost_s: Array
    rejected: int
    lost: int
    rejects: Bools


class Went(NamedTuple):
    """Frames that went out, R at most, `most` of a tick: payload (R, 64), message, tick (R,).

    tally (2,): frames that came, and those of them that came in ticks where all were decoded;
    peak (N,): largest probability of loss that was said of each drive, NaN while none was.
    """

    payload: NDArray[np.uint8]
    message: Ints
    tick: Ints
    tally: Ints
    peak: Array
    most: int


class Left(NamedTuple):
    """How a call was left.

    done: ticks that are whole; stage: that the next one is left at (`_ticks_kernels`); first: its
    first frame that is not in, or that behind the last; seen: `temperatures` of `struct received`;
    changed: whether the last whole tick changed a flag; frames: in `Went`; busy_s.
    """

    done: int
    stage: int
    first: int
    seen: int
    changed: bool
    frames: int
    busy_s: float


def went(rows: int, most: int, n: int) -> Went:
    """Room for so many rows, and for N drives."""
    message, tick = np.zeros((2, rows), dtype=np.int64)
    payload = np.zeros((rows, 64), dtype=np.uint8)
    return Went(payload, message, tick, np.zeros(2, dtype=np.int64), np.full(n, np.nan), most)
