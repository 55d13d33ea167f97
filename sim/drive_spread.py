"""Differences between the drives of a scenario: motors, shares, wheels, sensors.

May know: scenarios. May not know: bits, buses, clocks, the plant's state.
"""

from __future__ import annotations

import numpy as np

from dbc.arrays import Array
from sim.physics.plant import SLIP_LIMITERS, Motor, parameters, set_slip_limiter
from sim.physics.sensors import PHASES
from sim.scenario import Scenario
from sim.scenario_schema import Factors

_R_S, _L_S, _PSI, _SHARE, _WHEEL, _OFFSET, _GAIN = 6, 7, 8, 9, 12, 13, 14
"""Purposes of the random streams: one generator per purpose and drive."""


class Variety:
    """The drives' own numbers, drawn once; drives are counted from 0."""

    def __init__(self, scenario: Scenario, motor: Motor) -> None:
        """Everything random comes from the scenario's seed."""
        self._seed, self._n = scenario.seed, scenario.drives
        m, load, sensors = scenario.mismatch, scenario.load, scenario.sensors
        self.p = parameters(motor, self._n)
        """(N,) parameters of the plant, `struct sim_motor`."""
        self.p.R_s *= self._factors(m.R_s, m.R_s_within, _R_S)
        self.p.L_s *= self._factors(m.L_s, m.L_s_within, _L_S)
        self.p.psi_pm *= self._factors(m.psi_pm, m.psi_pm_within, _PSI)
        self.p.share = self._factors(load.share, load.share_within, _SHARE)
        self.p.wheel = self._factors(load.wheel, load.wheel_within, _WHEEL)
        set_slip_limiter(self.p, SLIP_LIMITERS[scenario.slip_limiter])
        if scenario.motion.effort_nm is not None:
            self.p.effort_nm = scenario.motion.effort_nm
        self.torque_scale: Array = motor.psi_pm / self.p["psi_pm"]
        """(N,) torque that a drive calculates, relative to its true torque."""
        self.offset: Array = sensors.current_offset_a + self._within(
            sensors.current_offset_within_a, _OFFSET, PHASES
        )
        """(N, 3) A, per phase."""
        self.gain: Array = sensors.current_gain * (
            1.0 + self._within(sensors.current_gain_within, _GAIN, PHASES)
        )
        """(N, 3), per phase."""
        self._share = self.p.share.copy()
        self._curves = [(scenario.nodes.index(curve.drive), curve) for curve in load.curve]

    def share(self, t_s: float) -> Array:
        """(N,) share of the load that falls to each drive at this time."""
        out = self._share.copy()
        for k, curve in self._curves:
            x = (t_s - curve.at_s) / curve.for_s
            if 0.0 <= x < 1.0:
                out[k] *= 1.0 + curve.amount * np.sin(np.pi * x)
        return out

    def _within(self, limit: float, purpose: int, each: int) -> Array:
        """(N, each) uniform draws of up to +- `limit`."""
        if not limit:
            return np.zeros((self._n, each))
        rows = [
            np.random.default_rng([self._seed, purpose, d]).uniform(-limit, limit, each)
            for d in range(self._n)
        ]
        return np.stack(rows)

    def _factors(self, given: Factors, limit: float, purpose: int) -> Array:
        """(N,) the factors given times those drawn."""
        out: Array = np.broadcast_to(given, self._n) * (1.0 + self._within(limit, purpose, 1)[:, 0])
        return out
