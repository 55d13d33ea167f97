"""What each drive carries and was told to carry, as arrays per unit of its rated torque.

Shares make commands comparable, the rotor's own acceleration is taken into account, and one that
runs away is seen. May know: numbers. May not know: frames, clocks, flags.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from dbc.records import (
    COMMAND_RESPONSE,
    LOAD_OBSERVATION,
    LOAD_RATIO,
    LOAD_SPREAD,
    Records,
)
from gateway.config import Motor
from gateway.health import NEVER

FOLLOWING_NS: Final[Nanos] = 2 * SECOND
"""A drive's torque is back a second after its flag cleared; twice that."""
COASTING: Final = 0.05
"""Below this share of rated torque the commands say nothing about each other."""
SHARE_FLOOR: Final = 0.2
SHARE_UNKNOWN: Final = 0.1
"""A drive commanded less than a tenth of the others carries too little to be judged."""
LEAST_LOAD: Final = 0.07
MORE_LOAD: Final = 0.10
"""Per unit of rated torque that drives carry in common, down to which, and from which on, they are
compared: with less a lost wheel is as good as one that holds."""
LOAD_TAU_S: Final = 0.2
"""Time constant of that common load: noise must not decide."""
ENOUGH_TO_COMPARE: Final = 2
"""Drives. With fewer a sudden loss is told by the rotor; with more, all of whose loads fall, it may
be the train's, and the next commands decide."""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


class Instant(NamedTuple):
    """Loads of N drives at one tick, per unit of rated torque.

    load: (N,) in the train's direction, as estimated; share: (N,) of full command; known: (N,);
    follows: (N,) the drive follows, or followed just now, its own flag.
    """

    load: Array
    share: Array
    known: Flags
    follows: Flags


class Rotors(NamedTuple):
    """Rated torque and inertia, and what is remembered of each, (N,), NaN where nothing is.

    taken, load: what accelerates the rotor with its train, and what it carries in the train's
    direction, per unit; above: more than its command and than the others (`train`), so that it is
    no measure for them; rank: scratch; lost_ns: when its flag last said `AdhesionLost`,
    `NEVER` before; speed, gain: of the tick before, for a drive that is judged alone.
    """

    rated: Array
    inertia: Array
    taken: Array
    load: Array
    above: Flags
    rank: Array
    lost_ns: Ints
    speed: Array
    gain: Array


class Trust(NamedTuple):
    """known_ns (N,): since when each load is known; bad_ns (1,): when last any wheel was lost.

    `NEVER` where it is not, or never was. loaded (1,): the drives carry enough to be compared;
    common (1,): smoothed load that they carry in common, per unit, NaN where it is not known.
    """

    known_ns: Ints
    bad_ns: Ints
    loaded: Flags
    common: Array


class Room(NamedTuple):
    """Of one tick, (N,): what the drives are compared by, and what comes of it.

    alone, meant: what each says by itself; severe: drives that carry so much less than the others
    that noise cannot be the cause; healthy: who may be learnt from; observed: `load_observation`.
    """

    referred: Array
    spread: Array
    alone: Array
    meant: Flags
    lost: Array
    known: Flags
    severe: Flags
    healthy: Flags
    observed: Records


class LoadReference(NamedTuple):
    """What is learnt of healthy loads: one `load_spread`, and `load_ratio` of N drives, (N,)."""

    all: Records
    drives: Records


def load_reference(n: int, spread: float) -> LoadReference:
    """Nothing learnt yet; `spread` per unit of rated torque."""
    made = LoadReference(np.zeros(1, LOAD_SPREAD), np.zeros(n, LOAD_RATIO))
    lib.load_reference_reset(
        ffi.from_buffer("struct load_spread *", made.all),
        ffi.from_buffer("struct load_ratio[]", made.drives), n, spread,
    )  # fmt: skip
    return made


def rotors(motors: Sequence[Motor]) -> Rotors:
    """Nothing remembered."""
    n = len(motors)
    return Rotors(
        np.array([m.T_rated for m in motors]), np.array([m.J for m in motors]), np.zeros(n),
        np.full(n, np.nan), np.zeros(n, dtype=np.bool_), np.zeros(n),
        np.full(n, NEVER, dtype=np.int64), np.full(n, np.nan), np.zeros(n),
    )  # fmt: skip


def instant(n: int) -> Instant:
    """Room for N drives."""
    known, follows = np.zeros((2, n), dtype=np.bool_)
    return Instant(np.zeros(n), np.ones(n), known, follows)


def responses(n: int) -> Records:
    """`command_response` of N drives of which no command is known."""
    return np.zeros(n, COMMAND_RESPONSE)


def trust(n: int) -> Trust:
    """Nothing known yet, and nothing lost."""
    known_ns, bad_ns = np.full(n, NEVER, dtype=np.int64), np.full(1, NEVER, dtype=np.int64)
    return Trust(known_ns, bad_ns, np.zeros(1, dtype=np.bool_), np.full(1, np.nan))


def room(n: int) -> Room:
    """Room for N drives."""
    referred, spread, alone, lost = np.zeros((4, n))
    meant, known, severe, healthy = np.zeros((4, n), dtype=np.bool_)
    observed = np.zeros(n, LOAD_OBSERVATION)
    return Room(referred, spread, alone, meant, lost, known, severe, healthy, observed)
