"""Thermal network of a motor, finer than any estimator's: six nodes, faults, a fault-free twin.

May know: heat. May not know: bits, buses, clocks, sensors' errors.

Nodes and the bench motor's figures (capacities J/K, conductances W/K; time constants at 25 rad/s):

    0 winding 450 --8-- 1 core 1400 --20-- 2 frame 1200 --7.5 (air)-- ambient
    3 drive-end bearing 150 --2-- frame     4 non-drive-end bearing 120 --1.8-- frame
    5 rotor 700 --1.5-- core, --0.6-- each bearing; bearings --0.25-- ambient

    winding 56 s, bearings 55 s, rotor 260 s, whole motor to ambient 650 s

A winding heated by 200 W more rises 0.4 K/s at first; without cooling a motor at 25 Nm rises
0.06 K/s; a bearing with 40 W more friction rises 0.25 K/s. Larger motors scale with T_rated.

Losses: copper 1.5 R_s |i|^2 (1 + 0.0039 (T_winding - 60)); iron 0.03 |w_e| + 2.5e-4 w_e^2 W, four
fifths in the core, one fifth in the rotor; bearing friction 0.1 |w_m| W each.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.physics.plant import BENCH, Motor
from sim.records import lib, pointer

Array = NDArray[np.float64]

NODES: Final[int] = lib.SIM_NODES
WINDING, CORE, FRAME, BEARING_DE, BEARING_NDE, ROTOR = range(NODES)
MEASURED: Final = (WINDING, BEARING_DE, BEARING_NDE)
"""Nodes with a sensor: stator, drive end, non-drive end."""

STEP_NS: Final = 10_000_000
CAPACITY: Final = np.array([450.0, 1400.0, 1200.0, 150.0, 120.0, 700.0])
LINKS: Final = (
    (WINDING, CORE, 8.0), (CORE, FRAME, 20.0), (FRAME, BEARING_DE, 2.0),
    (FRAME, BEARING_NDE, 1.8), (CORE, ROTOR, 1.5), (ROTOR, BEARING_DE, 0.6),
    (ROTOR, BEARING_NDE, 0.6),
)  # fmt: skip
AIR_STILL: Final = 5.0
AIR_PER_SPEED: Final = 0.10
AIR_LEFT: Final = 0.1
"""Share of the air cooling that a full cooling loss leaves (radiation, free convection)."""
BEARING_AIR: Final = 0.25
FRICTION: Final = 0.1
COPPER_SLOPE: Final = 0.0039
COPPER_REFERENCE: Final = 60.0

AIR_SPREAD: Final = 0.03
FRICTION_SPREAD: Final = 0.08
LOCAL_AIR_SPREAD: Final = 0.5


class ThermalTrain:
    """N motors, each with a twin that gets the same losses but none of the faults."""

    def __init__(self, motor: Motor, drives: int, ambient_c: float, train_seed: int) -> None:
        """All nodes at ambient.

        The motors differ: air flow 3 %, friction 8 %, local air 0.5 K (one sigma), drawn from
        `train_seed` and the drive's number, so that the same train runs in every scenario.
        """
        self.motor = motor
        self.scale = motor.T_rated / BENCH.T_rated
        spread = np.stack(
            [np.random.default_rng([train_seed, 10, d]).standard_normal(3) for d in range(drives)]
        )
        self.air_flow = 1.0 + AIR_SPREAD * np.clip(spread[:, 0], -2.5, 2.5)
        self.friction = 1.0 + FRICTION_SPREAD * np.clip(spread[:, 1], -2.5, 2.5)
        self.ambient = ambient_c
        self._beside = LOCAL_AIR_SPREAD * np.clip(spread[:, 2], -2.5, 2.5)
        self.local_air = ambient_c + self._beside
        self.drives = drives
        self.capacity = CAPACITY * self.scale
        link = np.zeros((NODES, NODES + 1))
        for a, b, g in LINKS:
            link[a, b] = link[b, a] = g * self.scale
        link[BEARING_DE, NODES] = link[BEARING_NDE, NODES] = BEARING_AIR * self.scale
        self._link = np.tile(link, (2 * drives, 1, 1))
        self._air = np.tile(self.local_air, 2)
        self._state = np.repeat(self._air[:, None], NODES, axis=1)

    def set_ambient(self, ambient_c: float) -> None:
        """Change the temperature of the air around the train, as in a tunnel."""
        self.ambient = ambient_c
        self.local_air = ambient_c + self._beside
        self._air = np.tile(self.local_air, 2)

    @property
    def temperatures(self) -> Array:
        """(N, 6) degC of the real motors."""
        return self._state[: self.drives]

    @property
    def healthy(self) -> Array:
        """(N, 6) degC of the fault-free twins."""
        return self._state[self.drives :]

    def _sources(self, state: Array, i_squared: Array, w_m: Array) -> tuple[Array, Array]:
        """Losses (M, 6) W without the winding's temperature term, and copper loss (M,) at 60."""
        w_e = self.motor.pole_pairs * np.abs(w_m)
        iron = (0.03 * w_e + 2.5e-4 * w_e**2) * self.scale
        friction = np.tile(self.friction, 2) * FRICTION * np.abs(w_m) * self.scale
        copper: Array = 1.5 * self.motor.R_s * i_squared
        q = np.zeros_like(state)
        q[:, WINDING] = copper
        q[:, CORE] = 0.8 * iron
        q[:, ROTOR] = 0.2 * iron
        q[:, BEARING_DE] = friction
        q[:, BEARING_NDE] = friction
        return q, copper

    def _cooling(self, w_m: Array, lost: Array) -> None:
        air = self.scale * (AIR_STILL + AIR_PER_SPEED * np.abs(w_m)) * np.tile(self.air_flow, 2)
        left = np.ones(2 * self.drives)
        left[: self.drives] = 1.0 - (1.0 - AIR_LEFT) * lost
        self._link[:, FRAME, NODES] = air * left

    def settle(self, i_squared: Array, w_m: Array) -> None:
        """Put motors and twins into the steady state of currents |i|^2 (N,) A^2, speeds (N,)."""
        i2, w = np.tile(i_squared, 2), np.tile(w_m, 2)
        q, copper = self._sources(self._state, i2, w)
        self._cooling(w, np.zeros(self.drives))
        for j in range(2 * self.drives):
            g = self._link[j]
            a = np.diag(g.sum(axis=1)) - g[:, :NODES]
            a[WINDING, WINDING] -= copper[j] * COPPER_SLOPE
            b = q[j] + g[:, NODES] * self._air[j]
            b[WINDING] -= copper[j] * COPPER_SLOPE * COPPER_REFERENCE
            self._state[j] = np.linalg.solve(a, b)

    def set_uniform(self, celsius: float) -> None:
        """Put every node to one temperature."""
        self._state[:] = celsius

    def advance(self, i_squared: Array, w_m: Array, extra_w: Array, cooling_lost: Array) -> None:
        """One step of 10 ms.

        Mean |i|^2 (N,) A^2, rotor speed (N,) rad/s, fault heat (N, 6) W, and the share of the air
        cooling lost (N,) 0..1; the last two for the real motors only.
        """
        w = np.tile(w_m, 2)
        q, copper = self._sources(self._state, np.tile(i_squared, 2), w)
        q[:, WINDING] += copper * COPPER_SLOPE * (self._state[:, WINDING] - COPPER_REFERENCE)
        q[: self.drives] += extra_w
        self._cooling(w, cooling_lost)
        heat_step(self._state, q, self._link, self.capacity, self._air, STEP_NS * 1e-9)


def heat_step(
    state: Array, sources: Array, link: Array, capacity: Array, air: Array, dt: float
) -> None:
    """One step of M networks (`sim_heat_step` in thermal.c); `state` (M, 6) degC in place.

    `sources` (M, 6) W, `link` (M, 6, 7) W/K (column 6: to the air), `capacity` (6,) J/K, `air` (M,)
    degC.
    """
    lib.sim_heat_step(
        len(state), pointer("double", sources), pointer("double", link),
        pointer("double", capacity), pointer("double", air), dt, pointer("double", state),
    )  # fmt: skip
