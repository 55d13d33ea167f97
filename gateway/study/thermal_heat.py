"""Heat of the labelled trains' 350 kW motors: six nodes, from currents and speed to temperatures.

May know: heat. May not know: any method of detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Ints
from sim.physics.plant import TRACTION_350KW
from sim.records import ffi, lib, pointer

MOTORS: Final = 4
NODES: Final = 6
WINDING, CORE, FRAME, BEARING_DE, BEARING_NDE, ROTOR = range(NODES)
MEASURED: Final = (WINDING, BEARING_DE, BEARING_NDE)
CAPACITY: Final = np.array([31e3, 150e3, 100e3, 9e3, 8e3, 75e3])
"""J/K: 80 kg of copper, 325 kg of iron, 200 kg of frame, two bearings with their shields, 160 kg of
rotor: 850 kg in all (paper `thermal`, Table 1)."""
LINKS: Final = (
    (WINDING, CORE, 150.0), (CORE, FRAME, 400.0), (FRAME, BEARING_DE, 14.0),
    (FRAME, BEARING_NDE, 12.0), (CORE, ROTOR, 25.0), (ROTOR, BEARING_DE, 8.0),
    (ROTOR, BEARING_NDE, 8.0),
)  # fmt: skip
"""W/K. Time constants: winding 200 s, bearings 400 s, the whole motor 40 min."""
AIR_STILL, AIR_PER_SPEED, BEARING_AIR = 40.0, 0.40, 6.0
"""To the air: frame, W/K; frame, W/K per rad/s of the fan; each bearing, W/K."""
IRON, FRICTION, ROTOR_SHARE = (2.0, 0.028), 0.35, 0.2
"""Iron loss, W per rad/s and per (rad/s)^2; friction, W per rad/s and bearing; share of the iron
loss that is in the rotor."""
COPPER_SLOPE, COPPER_REFERENCE = 0.0039, 60.0


class Ills(NamedTuple):
    """Causes of a fault in one motor.

    heat (L,) W in `node`; blocked (L,) share of its air; resistance (L,) factor on the winding's.
    """

    motor: int
    node: int
    heat: Array
    blocked: Array
    resistance: Array


def no_ills(steps: int) -> Ills:
    """`Ills` of a healthy motor, without any fault, for so many steps."""
    return Ills(0, WINDING, np.zeros(steps), np.zeros(steps), np.ones(steps))


def _links() -> Array:
    """(6, 6) W/K."""
    g = np.zeros((NODES, NODES))
    for a, b, w in LINKS:
        g[a, b] = g[b, a] = w
    return g


def settled(square: float, speed: float, blocked: float, resistance: float, extra: Array) -> Array:
    """Rise (3,) above ambient, K, at the measured points, in the steady state of a mean motor."""
    g = _links()
    matrix = np.diag(g.sum(axis=1)) - g
    matrix[FRAME, FRAME] += (AIR_STILL + AIR_PER_SPEED * speed) * (1.0 - blocked)
    matrix[BEARING_DE, BEARING_DE] += BEARING_AIR
    matrix[BEARING_NDE, BEARING_NDE] += BEARING_AIR
    copper = 1.5 * TRACTION_350KW.R_s * square * resistance
    iron = IRON[0] * speed + IRON[1] * speed**2
    q = extra.copy()
    q[WINDING] += copper
    q[CORE] += (1.0 - ROTOR_SHARE) * iron
    q[ROTOR] += ROTOR_SHARE * iron
    q[BEARING_DE] += FRICTION * speed
    q[BEARING_NDE] += FRICTION * speed
    return np.asarray(np.linalg.solve(matrix, q)[list(MEASURED)])


def heat_record(
    step_s: float, square: Array, speed: Array, unlike: tuple[Array, Array, Array], ills: Ills,
    at: Ints,
) -> Array:  # fmt: skip
    """Temperatures (K, M, 3) degC at the measured points; the motors have run for some hours.

    unlike: local air degC, factors on cooling air and friction, each (L, M).
    """
    local, air, friction = unlike
    start = settled(float(square.mean()), float(np.abs(speed).mean()), 0.0, 1.0, np.zeros(NODES))
    state = np.full((MOTORS, NODES), float(local[0].mean() + 0.6 * start.mean()))
    state[:, WINDING] += 0.4 * start[0]
    copper = 1.5 * TRACTION_350KW.R_s * square
    copper[:, ills.motor] *= ills.resistance
    cooling = (AIR_STILL + AIR_PER_SPEED * np.abs(speed))[:, None] * air
    cooling[:, ills.motor] *= 1.0 - ills.blocked
    iron = IRON[0] * np.abs(speed) + IRON[1] * speed**2
    rub = FRICTION * np.abs(speed)[:, None] * friction
    out = np.empty((len(at), MOTORS, NODES))
    held = [np.ascontiguousarray(x, float) for x in (
        copper, iron, rub, cooling, local, ills.heat, _links(), CAPACITY,
    )]  # fmt: skip
    *courses, link, capacity = (pointer("double", x) for x in held)
    steps = np.ascontiguousarray(at, np.int64)
    record = ffi.new("struct sim_heat_record *", [
        len(copper), MOTORS, len(at), step_s, BEARING_AIR, ROTOR_SHARE, COPPER_SLOPE,
        COPPER_REFERENCE, *courses, ills.motor, ills.node, link, capacity,
        pointer("int64_t", steps),
    ])  # fmt: skip
    lib.sim_heat_record(record, pointer("double", state), pointer("double", out))
    return out[:, :, list(MEASURED)]
