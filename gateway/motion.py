"""The drives' own speed and torque: load by observer, where the currents come too slowly.

Ten samples per electrical revolution are about the least that the filters need. Beyond that the
load comes from the observer, without a bump; without fresh `Motion` it is unknown. Below it the
measured speed is a witness: it sees what currents alone cannot, swapped phases, an aliased speed, a
wrong sign, and that a drive turns to which there is no lock. May know: estimators, readings. May
not know: frames, clocks, flags.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from dbc.records import Columns
from estimators.observer import LoadState
from gateway._direct import Direct
from gateway._motion_kernels import merge_motion, observe_motion
from gateway.config import Estimator, Motor
from gateway.inputs import Inputs
from gateway.slow import Readings
from gateway.tracks import Told

FEWEST_SAMPLES: Final = 10.0
"""Per electrical revolution."""
HYSTERESIS: Final = 0.05
SETTLED_READINGS: Final = 5
MOST_MISSING: Final = 5
"""Periods without a reading after which the observer starts anew."""
HAND_OVER_S: Final = 0.5
"""Time constant with which the difference between two sources fades."""
SPEED_FLOOR_VAR: Final = 1e-8
"""(rad/s)^2: a DBC may carry speed as a float."""
FADED_NM: Final = 1e-3
SUB_STEP_S: Final = 125e-6
"""What the configured process noise is stated for."""
SPEED_TOLERANCE: Final = 0.15
SPEED_TOLERANCE_RAD_S: Final = 5.0
"""At the rotor. The flux may be off by a tenth, and Motion is up to 10 ms old in a slip."""
TICKS: Final = 5
"""In a row that the two speeds must be apart."""
LOCKED_NS: Final = SECOND
"""A rotor that turns is locked to within this, or its currents and voltages are not what they seem:
an open phase, a wrong motor."""
TURNS: Final = 2.0
"""Times the least speed that is observable."""

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Timebase(NamedTuple):
    """When readings come.

    sample_s: spacing of the current samples; period_ns, speed_step: cycle and resolution of
    `Motion` (rad/s at the rotor).
    """

    sample_s: float
    period_ns: Nanos
    speed_step: float


class Memory(NamedTuple):
    """What is remembered of every drive, (N,).

    observer (N, 7): its `LoadState`, once it has begun; last_ns: stamp of the last reading;
    readings: since it began; beyond: the drive turns too fast for its current samples; load: what
    was told in the tick before, NaN if it was unknown, observed: by whom; offset: what is left of
    the difference where that changed; apart: ticks in a row that the two speeds have been;
    unlocked_ns: how long it has turned, by its own word, with no lock to it; wrong: its input
    cannot be what it seems.
    """

    observer: Array
    begun: Flags
    last_ns: Ints
    readings: Ints
    beyond: Flags
    load: Array
    observed: Flags
    offset: Array
    apart: Ints
    unlocked_ns: Ints
    wrong: Flags


class Limits(NamedTuple):
    """When what is believed: the constants above; mechanics (N, 4) as `observer.Mechanics`."""

    mechanics: Array
    pole_pairs: Array
    period_ns: int
    tick_ns: int
    limit_w_e: float
    hysteresis: float
    most_missing: int
    settled_readings: int
    fade: float
    faded_nm: float
    turning_rad_s: float
    locked_ns: int
    tolerance: float
    tolerance_rad_s: float
    ticks: int


class MotionSide:
    """Observers of N drives; `take` and then `settle`, once per tick."""

    def __init__(
        self,
        motors: Sequence[Motor],
        config: Estimator,
        times: Timebase,
        tick_ns: Nanos,
    ) -> None:
        """Noise is that of the configuration, per unit of each motor's rated torque."""
        # A real encoder adds about as much again as rounding does.
        speed_var = 2.0 * times.speed_step**2 / 12.0 + SPEED_FLOOR_VAR
        rows = [
            (m.J, m.B, speed_var, config.process_noise[4] * (m.T_rated / 30.0) ** 2 / SUB_STEP_S)
            for m in motors
        ]
        self.limits = Limits(
            np.array(rows).reshape(-1, 4), np.array([float(m.pole_pairs) for m in motors]),
            times.period_ns, tick_ns, 2.0 * math.pi / (FEWEST_SAMPLES * times.sample_s), HYSTERESIS,
            MOST_MISSING, SETTLED_READINGS, math.exp(-tick_ns / SECOND / HAND_OVER_S), FADED_NM,
            TURNS * config.min_speed_rad_s, LOCKED_NS, SPEED_TOLERANCE, SPEED_TOLERANCE_RAD_S,
            TICKS,
        )  # fmt: skip
        n = len(motors)
        self.memory = Memory(
            observer=np.zeros((n, len(LoadState._fields))),
            begun=np.zeros(n, dtype=np.bool_),
            last_ns=np.zeros(n, dtype=np.int64),
            readings=np.zeros(n, dtype=np.int64),
            beyond=np.zeros(n, dtype=np.bool_),
            load=np.full(n, np.nan),
            observed=np.zeros(n, dtype=np.bool_),
            offset=np.zeros(n),
            apart=np.zeros(n, dtype=np.int64),
            unlocked_ns=np.zeros(n, dtype=np.int64),
            wrong=np.zeros(n, dtype=np.bool_),
        )
        self._read, self._settle = Direct(observe_motion), Direct(merge_motion)

    def take(self, readings: Readings, count: int, flux: Array) -> None:
        """Readings of one tick, in order of time, the first `count` of them.

        flux (N,): a drive's magnets' over that of the data sheet, from which it computes the
        torque that it sends; NaN where nothing is known.
        """
        self._read(readings, count, flux, self.memory, self.limits)

    def settle(
        self, inputs: Inputs, sensors: Columns, until_ns: Ints, now: Nanos, told: Told
    ) -> Flags:
        """Changes `told` to what is to be used; which drives' input cannot be what it seems, (N,).

        inputs: speeds of fresh `Motion`, and whose currents are fresh; sensors: who sees that
        currents do not turn with a rotor that does; until_ns (N,): see `plausibility`.
        """
        self._settle(inputs, sensors, until_ns, now, told, self.memory, self.limits)
        return self.memory.wrong
