"""What several ticks in one call are done with: the parts of a gateway, as its own steps use them.

May know: tables of the parts. May not know: frames, clocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import TX_FRAME, Records
from gateway import loads, motion, plausibility, tracks, train
from gateway.channel import ChannelState
from gateway.flags import Status
from gateway.inputs import Inputs, Places
from gateway.pairing import PairState, Samples
from gateway.receiving import Scratch, Wiring
from gateway.slow import Readings, SlowState

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Receiving(NamedTuple):
    """Frames in, as `Inbox.take` and `BusLoad.add_block`; which inputs are believed.

    receiver, supervision, load: addresses of the records; tick: part of the receiver's;
    integrity (1,); lost (N,): drives whose heartbeat has stopped.
    """

    period_ns: int
    receiver: int
    tick: Records
    state: ChannelState
    wiring: Wiring
    pairs: PairState
    slow: SlowState
    scratch: Scratch
    readings: Readings
    out: Samples
    supervision: int
    load: int
    integrity: Records
    lost: Bools
    places: Places


class Filtering(NamedTuple):
    """As `Bank.advance` and `MotionSide`."""

    inputs: Inputs
    believed: tracks.Believed
    constants: tracks.Constants
    room: tracks.Room
    motion: motion.Memory
    limits: motion.Limits
    check: plausibility.Plausibility
    check_limits: plausibility.PlausibilityLimits


class Judging(NamedTuple):
    """As `AdhesionSide.judge` with `VariationalDetector`, whose opinion fills lost, known (N,).

    rough (4, N): its workspace; learn_ns: when drives are learnt from next; every_ns: how often.
    """

    flag: Ints
    since_ns: Ints
    tick_s: float
    rotors: loads.Rotors
    train: train.Train
    reference: loads.LoadReference
    own: loads.LoadReference
    passing: float
    part: float
    spreads: float
    at: loads.Instant
    responses: Records
    trust: loads.Trust
    room: loads.Room
    rules: Records
    common_mode: Records
    priors: Array
    sweeps: int
    lost: Array
    known: Bools
    rough: Array
    learn_ns: int
    every_ns: int
    settled_ns: int
    probably: float


class Saying(NamedTuple):
    """Temperatures, flags and frames out. temperatures, transmitter: addresses of the records."""

    temperatures: int
    train_inputs: Records
    inputs: Records
    evidence: Records
    status: Status
    transmitter: int


class Went(NamedTuple):
    """Frames that went out, (R,) of `struct tx_frame`, `most` of a tick at most.

    tally (2,): frames that came, and those of them that came in ticks where all were decoded;
    peak (N,): largest probability of loss that was said of each drive, NaN while none was.
    """

    frames: Records
    tally: Ints
    peak: Array
    most: int


class Left(NamedTuple):
    """How a call was left.

    done: ticks that are whole; stage: that the next one is left at (`_ticks_kernels`); first: its
    first frame that is not in, or that behind the last; samples, seen, motions: of the last frames
    (samples, temperatures, motions of `struct received`); changed: whether the last whole tick
    changed a flag; frames: in `Went`; common: load in the last tick, per unit; learn_ns:
    when drives are learnt from next.
    """

    done: int
    stage: int
    first: int
    samples: int
    seen: int
    motions: int
    changed: bool
    frames: int
    common: float
    learn_ns: int


def went(rows: int, most: int, n: int) -> Went:
    """Room for so many rows, and for N drives."""
    return Went(np.zeros(rows, TX_FRAME), np.zeros(2, dtype=np.int64), np.full(n, np.nan), most)
