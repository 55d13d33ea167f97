"""What is said of every drive, as arrays: flags with their evidence, reasons, numbers.

May know: words of the message set, the table of `decide`. May not know: frames, clocks, bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.decide import HOLDS, TABLE, Timing
from gateway.health import NEVER, FaultClass, Flag, Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME: Final = -1
"""In place of evidence: it stands as it was, and no flag changes by it."""


class Which(IntEnum):
    """Row of a drive's flag in `Flags`."""

    ADHESION = 0
    THERMAL = 1
    COMM = 2
    ESTIMATOR = 3
    SENSOR = 4


class Rules(NamedTuple):
    """How evidence becomes flags, and when a loss is one.

    table (3, 3, 2): by flag and evidence the next flag, and which of a flag's times must have
    passed (0: none); timing (6, 4): of `Which`, the last row of a severe loss of adhesion: 0, then
    `decide.Timing`, ns; raise_at, clear_at: probabilities; tick_ns: period of the loop.
    """

    table: Ints
    timing: Ints
    raise_at: float
    clear_at: float
    tick_ns: int


class Flags(NamedTuple):
    """`decide.FlagState` of every flag and drive, (5, N)."""

    flag: Ints
    evidence: Ints
    since_ns: Ints


class Findings(NamedTuple):
    """What the thermal side has found of every drive, (N,): `thermal.Report`; NaN: not known.

    heard_ns: stamp of the last temperatures, `NEVER` before any.
    """

    thermal: Ints
    sensor: Ints
    reason: Ints
    fault_class: Ints
    fault_sensor: Ints
    mixed_c: Array
    maisd_k: Array
    rate_k_h: Array
    jumps: Ints
    heard_ns: Ints


class Whole(IntEnum):
    """Index into `Said.whole`: of all drives together."""

    ADHESION_REASON = 0
    FAULTS_REASON = 1
    SENSOR = 2
    COMM = 3
    ESTIMATOR = 4
    OVERRUN = 5
    STATE = 6
    DETECTOR = 7
    COMMON_MODE = 8
    AGE_NS = 9
    TEMPERATURE_AGE_NS = 10


class Said(NamedTuple):
    """One tick, (N,): what goes out. NaN where a number is not known, `NEVER` where an age is not.

    adhesion, thermal, sensor, comm, estimator: `Flag`, with the reasons of the first two where they
    are unknown. whole (11,): see `Whole`.
    """

    adhesion: Ints
    adhesion_reason: Ints
    thermal: Ints
    thermal_reason: Ints
    sensor: Ints
    comm: Ints
    estimator: Ints
    health: Ints
    speed: Array
    load: Array
    sigma: Array
    lost: Array
    nis: Array
    age_ns: Ints
    fault_class: Ints
    fault_sensor: Ints
    mixed_c: Array
    maisd_k: Array
    rate_k_h: Array
    jumps: Ints
    temperature_age_ns: Ints
    whole: Ints


def rules(
    timing: Sequence[Timing], raise_at: float, clear_at: float, tick_ns: int
) -> Rules:  # fmt: skip
    """timing: of every flag in the order of `Which`, then of a severe loss."""
    table = np.zeros((3, 3, 2), dtype=np.int64)
    for flag in Flag:
        for seen in Flag:
            target, hold = TABLE.get((flag, seen), (flag, ""))
            table[flag, seen] = target, HOLDS.index(hold)
    times = np.array([(0, *each) for each in timing], dtype=np.int64)
    return Rules(table, times, raise_at, clear_at, tick_ns)


def flags(n: int, start_ns: int) -> Flags:
    """All unknown since `start_ns`."""
    flag, evidence = np.full((2, len(Which), n), Flag.UNKNOWN, dtype=np.int64)
    return Flags(flag, evidence, np.full((len(Which), n), start_ns, dtype=np.int64))


def findings(n: int) -> Findings:
    """Nothing found."""
    thermal, sensor, fault_class, fault_sensor, jumps = np.zeros((5, n), dtype=np.int64)
    mixed_c, maisd_k, rate_k_h = np.full((3, n), np.nan)
    return Findings(
        thermal, sensor, np.full(n, Reason.STARTING, dtype=np.int64), fault_class, fault_sensor,
        mixed_c, maisd_k, rate_k_h, jumps, np.full(n, NEVER, dtype=np.int64),
    )  # fmt: skip


def said(n: int, detector: int) -> Said:
    """Everything unknown."""
    whole = np.zeros(len(Whole), dtype=np.int64)
    whole[[Whole.ADHESION_REASON, Whole.FAULTS_REASON]] = Reason.STARTING
    whole[[Whole.AGE_NS, Whole.TEMPERATURE_AGE_NS]] = NEVER
    whole[Whole.DETECTOR] = detector
    whole[Whole.OVERRUN] = Flag.GOOD

    def each(value: int) -> Ints:
        return np.full(n, value, dtype=np.int64)

    def unknown() -> Array:
        return np.full(n, np.nan)

    return Said(
        each(Flag.UNKNOWN), each(Reason.STARTING), each(Flag.UNKNOWN), each(Reason.STARTING),
        each(Flag.UNKNOWN), each(Flag.UNKNOWN), each(Flag.UNKNOWN), each(0),
        unknown(), unknown(), unknown(), unknown(), unknown(), each(NEVER),
        each(FaultClass.UNKNOWN), each(0), unknown(), unknown(), unknown(), each(0), each(NEVER),
        whole,
    )  # fmt: skip
