"""Currents and `Motion` that are well protected and wrong: held, late, turned, of another scale.

A converter that hangs behind a live CAN layer sends right counters and checksums with stale values.
Four witnesses tell, none of which needs the load:

- **repeated**: equal current vectors while the rotor turns; one is a sample that is late, more are
  held. On CAN FD also eight samples that are those of the frame before.
- **torque**: what the currents make at the rotor's angle against the torque that the drive reports,
  and the filter's load against that by `Motion`.
- **angle**: of the current against `ElectricalAngle`, where both are sent. What is constant between
  them is learnt, so no convention is assumed; a step is a current that is late, or another's.
- **Motion held**: equal `Speed` and `Torque` beyond 100 ms while others change.

May know: numbers. May not know: frames, clocks, flags. Not in paper `adhesion`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from gateway.config import Motor

HISTORY: Final = 8
"""Samples of a CAN FD frame."""
REPEATS: Final = 2
"""Repeated vectors in a row that are no single late sample."""
LEAST_STEPS: Final = 10.0
LEAST_SHARE: Final = 0.01
"""A vector is repeated if it should have moved by more: steps of its resolution, and per unit of
rated current (noise)."""
HELD_NS: Final[Nanos] = 200 * MS
LATE_NS: Final[Nanos] = SECOND
"""How long an input stays implausible after the last sign."""
RESTART_NS: Final[Nanos] = 20 * MS
"""So long before the end of that the filter begins anew."""
DOUBT_NS: Final[Nanos] = 15 * MS
"""After a single reading that does not fit: no loss is raised before the next one."""
IN_A_ROW: Final = 3
"""Readings in a row that do not fit, and the input is implausible for `HELD_NS`."""
LEAST_CURRENT: Final = 0.15
LEAST_TORQUE: Final = 0.1
"""Per unit of rated; with less, torque and angle say nothing."""
TORQUE_OFF: Final = 0.15
TORQUE_OFF_RELATIVE: Final = 0.3
"""Largest difference of two torques, per unit of rated, and of the reported one: magnets may be a
fifth off the data sheet."""
TORQUE_DOUBT: Final = 0.06
TORQUE_DOUBT_RELATIVE: Final = 0.15
"""From here on currents are no evidence of a loss."""
LOAD_OFF: Final = 0.25
LOAD_OFF_RELATIVE: Final = 0.3
LOADS_IN_A_ROW: Final = 4
"""The same of two loads; filter and observer follow a loss unlike for up to three readings."""
ANGLE_OFF: Final = 0.06
ANGLE_OFF_SAMPLES: Final = 0.3
"""Largest step of the angle, rad, and in turns of a sample period, at least of 0.5 ms: stamps
jitter, and more by as much as a frame of `Motion` is off the grid of its cycle."""
MOST_TURN: Final = 0.63
"""Turn between two samples, rad, beyond which nobody rests on the currents: ten a revolution."""
LEAST_PERIOD_S: Final = 0.5e-3
LEARN: Final = 20
"""Readings before the constant part of the angle is known."""
KEEP: Final = 0.98
"""Of what is learnt, per reading of 10 ms: half a second."""
COHERENT: Final = 0.95
"""Length of the mean of unit vectors, below which angle and current have nothing to do with one
another: another frame, another direction."""
LEARN_ANEW_NS: Final[Nanos] = 60 * SECOND
"""An angle that has been off for so long is the drive's new one."""
ANGLE_GAP_NS: Final[Nanos] = 100 * MS
"""After so long without a reading the angle of late is that of the next one."""
MOTION_HELD_NS: Final[Nanos] = 100 * MS
SPEED_MOVED: Final = 0.03
SPEED_MOVED_RAD_S: Final = 1.0
COMMAND_MOVED: Final = 0.15
"""What others must have changed by: a rotor's speed, or the command per unit of rated torque."""

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Plausibility(NamedTuple):
    """Memory of N drives.

    vector (N, 8, 2): the last currents, A, a ring; samples (N,): how many there were; equal,
    equal_s (N,): repeated vectors in a row, and for how long; block (N,): samples in a row that are
    those of eight before; until_ns (N,): implausible until then; restart (N,): the filter has to
    begin anew after it; doubt_ns (N,): until then nobody is accused by the currents; base (N,):
    learnt angle as a mean unit vector, from learnt (N,) readings; deviation (N,) rad: of late, at
    angle_ns (N,); off, torque_off, load_off, motion_held (N,): readings in a row that do not fit;
    off_ns (N,): since when the angle does not.

    Of `Motion`: speed, torque (N,) as last sent, changed_ns (N,) when they last changed, and what
    was so then: own, command (N,), others (N, N) speeds.
    """

    vector: Array
    samples: Ints
    equal: Ints
    equal_s: Array
    block: Ints
    until_ns: Ints
    restart: Flags
    doubt_ns: Ints
    base: NDArray[np.complex128]
    learnt: Ints
    deviation: Array
    off: Ints
    torque_off: Ints
    load_off: Ints
    motion_held: Ints
    off_ns: Ints
    angle_ns: Ints
    speed: Array
    torque: Array
    changed_ns: Ints
    own: Array
    command: Array
    others: Array


class PlausibilityLimits(NamedTuple):
    """Constants of N drives, (N,), and dt_s: the sub-step.

    k_torque: Nm per A at the data sheet's flux; least_moved_a: see `LEAST_STEPS`; period_s: between
    two current samples; motion_ns: between two `Motion`.
    """

    pole_pairs: Array
    k_torque: Array
    rated_a: Array
    rated_nm: Array
    least_moved_a: Array
    period_s: float
    dt_s: float
    motion_ns: int
    settled_readings: int


def start(n: int, doubt_ns: Ints) -> Plausibility:
    """Nothing received. doubt_ns (N,): where doubts are noted, for who judges."""

    def none() -> Array:
        return np.full(n, np.nan)

    def zero() -> Ints:
        return np.zeros(n, dtype=np.int64)

    return Plausibility(
        vector=np.zeros((n, HISTORY, 2)), samples=zero(), equal=zero(), equal_s=np.zeros(n),
        block=zero(), until_ns=zero(), restart=np.zeros(n, dtype=np.bool_),
        doubt_ns=doubt_ns,
        base=np.zeros(n, dtype=np.complex128), learnt=zero(),
        deviation=np.zeros(n), off=zero(), torque_off=zero(), load_off=zero(),
        motion_held=zero(), off_ns=zero(), angle_ns=zero(), speed=none(),
        torque=none(), changed_ns=zero(), own=none(), command=none(),
        others=np.full((n, n), np.nan),
    )  # fmt: skip


def limits(
    motors: Sequence[Motor], step_a: float, period_s: float, dt_s: float, motion_ns: Nanos,
    settled: int,
) -> PlausibilityLimits:  # fmt: skip
    """step_a: resolution of the currents on the bus; period_s: between two samples.

    settled: readings after which the load by `Motion` is known.
    """
    rated_a = np.array([m.I_rated for m in motors])
    return PlausibilityLimits(
        np.array([float(m.pole_pairs) for m in motors]),
        np.array([m.k_p * m.pole_pairs * m.psi_pm for m in motors]),
        rated_a, np.array([m.T_rated for m in motors]),
        np.maximum(LEAST_STEPS * step_a, LEAST_SHARE * rated_a), period_s, dt_s,
        motion_ns, settled,
    )  # fmt: skip
