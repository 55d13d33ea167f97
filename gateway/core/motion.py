"""Measured speed and torque compared with the estimates: records. The C sources have the rules.

If currents come too slowly, the load comes from an observer of speed and torque; otherwise the
measured speed checks the estimate, and currents and `Motion` are checked against one another. See
`gateway/core/motion.c`, `plausibility.c`, and the records in `gateway/core/records.h`. May know:
estimators, readings. May not know: frames, clocks, flags.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi

from dbc.arrays import Array
from dbc.frame import SECOND, Nanos
from dbc.records import MOTION, MOTION_MONITOR, PLAUSIBILITY, Addressed, Records, point_to
from gateway.core.channel import SAMPLE_NS
from gateway.core.estimate import Bank
from gateway.core.inputs import InputMonitor
from gateway.core.receiving import Receiver
from gateway.settings.config import Motor
from gateway.settings.sections import Estimator

FEWEST_SAMPLES: Final = 10.0
"""Current samples per electrical revolution: about the fewest that the filters need."""
SPEED_FLOOR_VAR: Final = 1e-8
"""(rad/s)^2: a DBC may carry speed as a float."""
SUB_STEP_S: Final = 125e-6
"""Sub-step that the configured process noise is stated for."""
TURNS: Final = 2.0
"""Times the least observable speed: above it a filter finds its rotor."""
CRAWLS: Final = 1.5
"""Times the least observable speed: below it the load comes from `Motion`, if there is one."""
LEAST_STEPS: Final = 10.0
LEAST_SHARE: Final = 0.01
"""An unchanged current is a repeated one if it should have changed by more than both: steps of its
resolution, and per unit of rated current (noise)."""


class Timebase(NamedTuple):
    """Spacing and resolution of the readings.

    sample_s: spacing of the current samples; period_ns, speed_step: cycle and resolution of
    `Motion` (rad/s at the rotor).
    """

    sample_s: float
    period_ns: Nanos
    speed_step: float


class MotionMonitor(Addressed):
    """`motion` and `plausibility` of N drives, (N,), as `motions` and `checks`.

    A copy is a monitor of its own.
    """

    pointer: Any

    def __init__(
        self, motors: Sequence[Motor], config: Estimator, times: Timebase, tick_ns: Nanos,
        current_step_a: float, receiver: Receiver, inputs: InputMonitor, bank: Bank,
        rotors: Records,
    ) -> None:  # fmt: skip
        """Noise is that of the configuration, per unit of each motor's rated torque.

        current_step_a: resolution of the currents on the bus; rotors: `rotor` of every drive, whose
        `unreliable_until_ns` is set here.
        """
        n = len(motors)
        self.receiver, self.inputs, self.bank, self.rotors = receiver, inputs, bank, rotors
        self.motions = _motions(motors, config, times.speed_step)
        self.checks = _checks(motors, current_step_a)
        self.checks["current_var"] = bank.noise["R"][:, 0]
        self.others: Array = np.full((n, n), np.nan)
        """Rows of all drives' measured speeds, rad/s, when `Motion` of some drive last changed."""
        self.noted, self.taken = np.arange(n, dtype=np.int64), np.zeros(n, dtype=np.bool_)
        """`noted`: row of `others` for each drive; `taken`: workspace."""
        self.record = np.zeros(1, MOTION_MONITOR)
        constants = {
            "max_w_e": 2.0 * math.pi / (FEWEST_SAMPLES * times.sample_s),
            "turning_w_e": TURNS * config.min_speed_rad_s,
            "crawl_w_e": CRAWLS * config.min_speed_rad_s,
            "period_s": times.sample_s, "dt": SAMPLE_NS / SECOND,
            "motion_cycle_ns": times.period_ns, "tick_ns": tick_ns, "n": n,
        }  # fmt: skip
        for name, value in constants.items():
            self.record[name] = value
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        point_to(self.record, {
            "receiver": self.receiver.record, "inputs": self.inputs.status,
            "estimates": self.bank.estimates, "filters": self.bank.filters,
            "chords": self.bank.chords, "sensors": self.bank.sensors, "rotors": self.rotors,
            "motions": self.motions, "checks": self.checks, "others": self.others,
            "noted": self.noted, "taken": self.taken,
        })  # fmt: skip
        self.pointer = ffi.from_buffer("struct motion_monitor *", self.record)


def _motions(motors: Sequence[Motor], config: Estimator, speed_step: float) -> Records:
    """`motion` of every drive; nothing measured yet."""
    made = np.zeros(len(motors), MOTION)
    mechanics = made["mechanics"]
    mechanics["J"], mechanics["B"] = [m.J for m in motors], [m.B for m in motors]
    # A real encoder adds about as much again as rounding does.
    mechanics["speed_var"] = 2.0 * speed_step**2 / 12.0 + SPEED_FLOOR_VAR
    mechanics["load_rate"] = [
        config.process_noise[4] * (m.T_rated / 30.0) ** 2 / SUB_STEP_S for m in motors
    ]
    made["pole_pairs"] = [m.pole_pairs for m in motors]
    made["smooth_speed"] = np.nan
    return made


def _checks(motors: Sequence[Motor], step_a: float) -> Records:
    """`plausibility` of every drive; nothing received yet. step_a: resolution of the currents."""
    made = np.zeros(len(motors), PLAUSIBILITY)
    rated_a = np.array([m.I_rated for m in motors])
    made["torque_per_a"] = [m.k_p * m.pole_pairs * m.psi_pm for m in motors]
    made["rated_a"], made["rated_nm"] = rated_a, [m.T_rated for m in motors]
    made["least_change_a"] = np.maximum(LEAST_STEPS * step_a, LEAST_SHARE * rated_a)
    for name in ("speed", "torque", "command"):
        made[name] = np.nan
    return made
