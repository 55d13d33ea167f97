"""Random trains by seed, with any motor on any bus; the other worlds keep motor and bus constant.

Motors of 0.5 to 500 kW, with nameplates drawn per unit; currents and voltages every 1 to 10 ms;
signals with a coarse or a fine step; with and without `Motion` and `Status`; 1 to 16 drives. Trains
with unobservable losses are not drawn: a single drive has a command, and a train without `Motion`
turns so slowly that its currents come at least ten times per revolution.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any, Final, NamedTuple

import numpy as np

from dbc.codec import Codec
from dbc.frame import MS
from dbc.frames import Block
from dbc.spec import MessageSpec
from sim.physics.plant import Motor

STREAM: Final = 41
POWER_KW: Final = (0.5, 500.0)
RATED_RAD_S: Final = (250.0, 1000.0)
"""Rated electrical speed, to which the power refers."""
POLE_PAIRS: Final = (2, 6)
RESISTANCE: Final = (0.01, 0.04)
REACTANCE: Final = (0.15, 0.55)
"""Per unit, at rated speed; RESISTANCE is per unit too."""
SPIN_UP: Final = (70.0, 1000.0)
"""Rated torque over inertia, rad/s2: from a motor with its wheelset to a bare one."""
PHASE_V: Final = (60.0, 0.4)
"""Phase voltage of a motor of 0.5 kW, V, and the exponent with which it grows with the power."""
LINK: Final = 1.15
"""DC-link voltage over the line voltage that 1.5 times the rated torque takes at rated speed."""
CYCLES_MS: Final = (1, 2, 4, 5, 10)
STEP: Final = (1e-4, 5e-3)
"""Step of a signal, over the rated value."""
ABSENT: Final = 0.3
"""Share of trains without `Motion`, and of those without `Status`."""
DRIVES: Final = 16
SLOWEST_RAD_S: Final = 40.0
FASTEST: Final = 0.7
"""Highest speed, over the rated speed."""
SAMPLES: Final = 10
"""Fewest samples per electrical revolution, without `Motion`."""
_RAW: Final = 32000


class Variation(NamedTuple):
    """One train. step: of its signals, over rated values; motion, status: these are sent."""

    motor: Motor
    drives: int
    speed_rad_s: float
    cycle_ms: int
    step: float
    motion: bool
    status: bool

    def sheet(self) -> dict[str, Any]:
        """`[motor]` of a scenario."""
        return asdict(self.motor)

    def codec(self, codec: Codec) -> Codec:
        """The message set with these cycles and steps."""
        return Codec(codec.path, (self._spec(spec) for spec in codec.messages))

    def received(self, block: Block, codec: Codec) -> Block:
        """Frames of a block that are on the bus."""
        absent = {"Motion": not self.motion, "Status": not self.status}
        gone = [spec.can_id for spec in codec.messages if absent.get(spec.kind)]
        return block.pick(~np.isin(block.can_id, gone))

    def _spec(self, spec: MessageSpec) -> MessageSpec:
        motor = self.motor
        rated = {"A": motor.I_rated, "V": motor.U_dc / 2.0, "Nm": motor.T_rated,
                 "rpm": self.speed_rad_s / motor.pole_pairs * 30.0 / math.pi}  # fmt: skip
        signals = tuple(
            replace(s, scale=max(self.step, 3.0 / _RAW) * rated[s.unit]) if s.unit in rated else s
            for s in spec.signals
        )
        fast = spec.kind in ("PhaseCurrents", "StatorVoltages")
        return replace(
            spec, signals=signals, cycle_ns=self.cycle_ms * MS if fast else spec.cycle_ns
        )


def variation(seed: int) -> Variation:
    """The train of this seed."""
    rng = np.random.default_rng([seed, STREAM])
    rated = float(rng.uniform(*RATED_RAD_S))
    motor = _motor(rng, rated)
    cycle_ms = int(rng.choice(CYCLES_MS))
    motion, status = (bool(x) for x in rng.random(2) >= ABSENT)
    slow = 2.0 * math.pi / (SAMPLES * cycle_ms * 1e-3)
    fastest = FASTEST * rated if motion else min(FASTEST * rated, slow)
    speed = float(rng.uniform(SLOWEST_RAD_S, fastest)) * float(rng.choice([-1.0, 1.0]))
    return Variation(
        motor, int(rng.integers(1 if status else 2, DRIVES, endpoint=True)), round(speed, 3),
        cycle_ms, _spread(rng, STEP), motion, status,
    )  # fmt: skip


def _spread(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draw with a uniform logarithm."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def _motor(rng: np.random.Generator, rated_rad_s: float) -> Motor:
    """Draw a motor of this rated electrical speed; `U_dc` allows 1.5 times its torque there."""
    watts = 1e3 * _spread(rng, POWER_KW)
    poles = int(rng.integers(*POLE_PAIRS, endpoint=True))
    torque = watts * poles / rated_rad_s
    r, x = (float(rng.uniform(*limits)) for limits in (RESISTANCE, REACTANCE))
    volts = PHASE_V[0] * (watts / 500.0) ** PHASE_V[1]
    psi = volts * math.sqrt(1.0 - x * x) / rated_rad_s
    amps = torque / (1.5 * poles * psi)
    ohms = volts / amps
    most = math.hypot(1.5 * x * volts, rated_rad_s * psi + 1.5 * r * volts)
    return Motor(
        R_s=r * ohms, L_s=x * ohms / rated_rad_s, psi_pm=psi, pole_pairs=poles,
        J=torque / _spread(rng, SPIN_UP), I_rated=amps, T_rated=torque,
        U_dc=LINK * math.sqrt(3.0) * most,
    )  # fmt: skip
