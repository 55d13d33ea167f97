"""What of every drive's input can be believed in a tick, as arrays: constants and findings.

May know: channels and their numbers. May not know: frames, clocks, estimators.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.health import Flag, Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

NONE = -1
"""No such channel."""


class Places(NamedTuple):
    """Constants of N drives.

    first, last (N,): its channels are first .. last - 1; electrical (N, 2), motion, status (N,):
    which of them, `NONE` where there is none; limit_ns: how old a sample may be; sum_limit_a: what
    the phases' sum may be, A.
    """

    first: Ints
    last: Ints
    electrical: Ints
    motion: Ints
    status: Ints
    limit_ns: Ints
    sum_limit_a: Array


class Inputs(NamedTuple):
    """Of N drives in this tick, (N,).

    cause: `Reason` why currents and voltages cannot be believed, NONE if they can; fresh: the
    newest sample is within its limit; commanded: the torque command is known; speed: of the rotor
    as measured, rad/s, NaN where it is not known; suspect: the phases' sum is not zero; comm:
    `Flag` that its messages give evidence of.
    """

    cause: Ints
    fresh: Flags
    commanded: Flags
    speed: Array
    suspect: Flags
    comm: Ints


def places(
    rows: Sequence[tuple[int, int, Sequence[int], int, int]],
    limit_ns: Sequence[int],
    sum_limit_a: Sequence[float],
) -> Places:
    """Of every drive its first and last channel, the electrical ones, Motion and Status."""
    n = len(rows)
    electrical = np.full((n, 2), NONE, dtype=np.int64)
    for mine, row in zip(electrical, rows, strict=True):
        mine[: len(row[2])] = row[2]
    first, last, motion, status = (
        np.array([row[k] for row in rows], dtype=np.int64).reshape(n) for k in (0, 1, 3, 4)
    )
    return Places(
        first, last, electrical, motion, status, np.array(limit_ns, dtype=np.int64),
        np.array(sum_limit_a, dtype=np.float64),
    )  # fmt: skip


def inputs(n: int) -> Inputs:
    """Room for N drives of which nothing is known."""
    return Inputs(
        cause=np.full(n, Reason.STARTING, dtype=np.int64),
        fresh=np.zeros(n, dtype=np.bool_),
        commanded=np.zeros(n, dtype=np.bool_),
        speed=np.full(n, np.nan),
        suspect=np.zeros(n, dtype=np.bool_),
        comm=np.full(n, Flag.UNKNOWN, dtype=np.int64),
    )
