"""Heat of the second world's motors: eight lumps, some merged in each train, cooling by node.

It is independent of `thermal_heat` and shares no number and no equation with it, so nothing that a
method has learnt there helps here. May know: heat. May not know: any method of detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Ints

SLOT, END_WINDING, CORE, FRAME, DRIVE_END, OTHER_END, ROTOR, GEARBOX = range(8)
MERGED: Final = {
    3: (0, 0, 0, 0, 1, 2, 0, 1),
    4: (0, 0, 1, 1, 2, 3, 1, 2),
    5: (0, 0, 1, 2, 3, 4, 1, 3),
    6: (0, 0, 1, 2, 3, 4, 5, 3),
    7: (0, 1, 2, 3, 4, 5, 6, 4),
    8: (0, 1, 2, 3, 4, 5, 6, 7),
}
"""By number of nodes: the node to which each lump belongs. Textbooks use three to eight nodes."""
CAPACITY: Final = np.array([20e3, 12e3, 140e3, 95e3, 12e3, 10e3, 80e3, 60e3])
"""J/K: 80 kg of copper, 300 kg of iron, 190 kg of frame, bearings with their shields, 170 kg of
rotor, 120 kg of the gearbox's housing, to which the drive end is bolted."""
LINKS: Final = (
    (SLOT, CORE, 170.0), (SLOT, END_WINDING, 120.0), (CORE, FRAME, 350.0),
    (END_WINDING, FRAME, 9.0),
    (FRAME, DRIVE_END, 13.0), (FRAME, OTHER_END, 15.0), (CORE, ROTOR, 30.0),
    (ROTOR, DRIVE_END, 6.0),
    (ROTOR, OTHER_END, 6.0), (DRIVE_END, GEARBOX, 11.0),
)  # fmt: skip
"""Lumps and the heat conductance between them, W/K."""
STILL: Final = np.array([0.0, 0.0, 0.0, 30.0, 2.0, 2.0, 0.0, 6.0])
MOVING: Final = np.array([0.0, 0.25, 0.0, 1.2, 0.06, 0.06, 0.0, 0.3])
"""To the air: W/K at standstill, and W/K per (rad/s)^0.8 of the rotor, as for turbulent flow."""
COPPER_SLOPE: Final = 0.0039
SHARE: Final = np.array([0.6, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Shares of the copper loss in the slots and in the end winding."""
STEP_S: Final = 1.0


class Network(NamedTuple):
    """M motors of n nodes.

    capacity (M, n) J/K; flow (M, n, n) W/K; spread (8, n): 1 where a lump belongs to a node; seen
    (3,): nodes of the sensors.
    """

    capacity: Array
    flow: Array
    spread: Array
    seen: Ints


def network(nodes: int, capacity: Array, links: Array) -> Network:
    """Network of M motors; capacity (M, 8), links (M, 10): factors on CAPACITY and LINKS."""
    spread = np.eye(nodes)[list(MERGED[nodes])]
    motors = len(capacity)
    flow = np.zeros((motors, 8, 8))
    for k, (a, b, watt) in enumerate(LINKS):
        for i, j in ((a, b), (b, a)):
            flow[:, i, j] += watt * links[:, k]
            flow[:, i, i] -= watt * links[:, k]
    seen = np.array([MERGED[nodes][lump] for lump in (END_WINDING, DRIVE_END, OTHER_END)])
    return Network((CAPACITY * capacity) @ spread, spread.T @ flow @ spread, spread, seen)


def settle(net: Network, heat: Array, copper: Array, cooling: Array, air: Array) -> Array:
    """Temperatures (M, n) degC in the steady state of the mean course; arguments as in `warm`."""
    winding = SHARE @ net.spread
    given = heat.mean(axis=0) @ net.spread + copper.mean(axis=0)[:, None] * winding
    away = cooling.mean(axis=0) @ net.spread
    settles = np.stack([np.diag(row) for row in away]) - net.flow
    given += away * air.mean(axis=0)[:, None]
    return np.asarray(np.linalg.solve(settles, given[..., None])[..., 0])


def warm(
    net: Network, start: Array, heat: Array, copper: Array, cooling: Array, air: Array
) -> Array:
    """Temperatures (L, M, 3) degC at the sensors, in steps of `STEP_S`, from `start` (M, n).

    heat, cooling (L, M, 8): W and W/K; copper (L, M) W at 60 degC; air (L, M) degC.
    """
    rate = STEP_S / net.capacity
    away = cooling @ net.spread
    push = (heat @ net.spread + away * air[:, :, None]) * rate
    drain, resistive = away * rate, copper[:, :, None] * (SHARE @ net.spread) * rate
    spreads, x = net.flow * rate[:, :, None], start
    hot = net.seen[0]
    out = np.empty((len(air), len(x), 3))
    for k in range(len(air)):
        more = 1.0 + COPPER_SLOPE * (x[:, hot : hot + 1] - 60.0)
        x = x + (spreads @ x[:, :, None])[..., 0] + push[k] - drain[k] * x + more * resistive[k]
        out[k] = x[:, net.seen]
    return out
