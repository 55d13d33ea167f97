"""Random single losses of adhesion, by seed, on which the detection figures are measured.

Nothing here is tuned to any detector; a score on a paper's own scenario flatters every method
that was tuned on it. `gateway.study.scenarios_family` has the other kinds of runs.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.physics.plant import BENCH, MOTORS, Motor
from sim.scenario import Scenario, parse

STREAM: Final = 20
"""Purpose of the random stream."""
ONSET_S: Final = (0.8, 1.6)
LENGTH_S: Final = (0.1, 2.0)
DEPTH: Final = (0.2, 1.0)
SPEED_RAD_S: Final = (40.0, 250.0)
LOAD_NM: Final = (8.0, 30.0)
RAMP_S: Final = 0.02
TAIL_S: Final = 0.8
TOP_RAD_S: Final = {"traction_350kw": 880.0}
"""Highest electrical speed of motors for which the bench motor's does not hold: 140 Hz."""


class PerUnit:
    """The bench motor's ranges, scaled to another motor: torque by T_rated, current by I_rated."""

    def __init__(self, motor: str, own: Motor | None = None) -> None:
        """Scale to `motor`, a name of `sim.physics.plant.MOTORS`, or to `own`, not listed there."""
        self.name = motor
        machine = own or MOTORS[motor]
        self._torque = machine.T_rated / BENCH.T_rated
        self._current = machine.I_rated / BENCH.I_rated
        self.speed = (SPEED_RAD_S[0], TOP_RAD_S.get(motor, SPEED_RAD_S[1]))
        """Range of electrical speeds, rad/s."""

    def nm(self, bench: float) -> float:
        """Scale a torque of the bench motor, Nm, rounded to 1 mNm."""
        return round(float(bench) * self._torque, 3)

    def amps(self, bench: float) -> float:
        """Scale a current of the bench motor, A."""
        return bench * self._current

    def noise(self, bench_var: float) -> float:
        """Scale a variance of currents of the bench motor, A^2."""
        return bench_var * self._current**2


def between(rng: np.random.Generator, limits: tuple[float, float], digits: int = 4) -> float:
    """Draw uniformly and round."""
    return round(float(rng.uniform(*limits)), digits)


def sign(rng: np.random.Generator) -> float:
    """Draw -1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def random_scenario(seed: int, motor: str = "bench") -> Scenario:
    """One run: rolling start with unknown angles, one loss on one drive.

    Uniform draws: speed 40-250 electrical rad/s and load 8-30 Nm, each of either sign; depth
    0.2-1, length 0.1-2 s, onset 0.8-1.6 s, linear edges of 0-20 ms, any of three drives, whose
    speed is controlled under a preset load. Runs end 0.8 s after the loss. Loads and noise are the
    bench motor's and scale with `motor`.
    """
    unit, rng = PerUnit(motor), np.random.default_rng([seed, STREAM])
    speed = rng.uniform(*unit.speed) * sign(rng)
    load = rng.uniform(*LOAD_NM) * sign(rng)
    onset, length, depth = (between(rng, limits) for limits in (ONSET_S, LENGTH_S, DEPTH))
    ramp, drive = between(rng, (0.0, RAMP_S)), int(rng.integers(1, 4))
    event = {
        "at_s": onset, "for_s": length, "drive": drive, "kind": "adhesion_loss", "depth": depth,
        "ramp_s": ramp,
    }  # fmt: skip
    title = f"random {seed}: {speed:.0f} rad/s, {unit.nm(load):.1f} Nm"
    table = {
        "title": f"{title}, {depth:.0%} of drive {drive} for {length:.2f} s",
        "seed": seed, "duration_s": round(onset + length + TAIL_S, 4), "drives": 3,
        "motor": {"name": motor}, "motion": {"speed": round(float(speed), 3)},
        "load": {"kind": "preset", "torque_nm": unit.nm(load)},
        "sensors": {"current_noise_var": unit.noise(2e-4)}, "event": [event],
    }  # fmt: skip
    return parse(table, f"random {seed}")
