"""Compiled loop of `labelled`: six nodes of heat per motor over a whole record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._kernelcache import njit

Array = NDArray[np.float64]


@njit(cache=True)
def run(
    state: Array,
    copper: Array,
    iron: Array,
    rub: Array,
    cooling: Array,
    local: Array,
    heat: Array,
    ill: int,
    node: int,
    links: Array,
    capacity: Array,
    constants: Array,
    dt: float,
    at: NDArray[np.int64],
    out: Array,
) -> None:
    """Explicit steps of `dt` (well below the shortest time constant, 200 s); state (M, 6) in place.

    copper (L, M) W at the reference temperature, iron (L,) W, rub (L, M) W per bearing, cooling (L,
    M) W/K, local (L, M) degC, heat (L,) W more in `node` of motor `ill`; constants: W/K of bearings
    to the air, rotor's share of the iron loss, copper's slope 1/K and its reference degC; out (K,
    M, 6): the state at the end of the steps `at`.
    """
    bearing_air, rotor_share, slope, reference = constants
    motors, nodes = state.shape
    q = np.empty(nodes)
    k = 0
    for step in range(copper.shape[0]):
        for m in range(motors):
            t = state[m]
            for a in range(nodes):
                flow = heat[step] if m == ill and a == node else 0.0
                for b in range(nodes):
                    flow += links[a, b] * (t[b] - t[a])
                q[a] = flow
            q[0] += copper[step, m] * (1.0 + slope * (t[0] - reference))
            q[1] += (1.0 - rotor_share) * iron[step]
            q[5] += rotor_share * iron[step]
            q[2] += cooling[step, m] * (local[step, m] - t[2])
            for a in (3, 4):
                q[a] += rub[step, m] + bearing_air * (local[step, m] - t[a])
            for a in range(nodes):
                t[a] += dt * q[a] / capacity[a]
        while k < at.shape[0] and at[k] == step:
            out[k] = state
            k += 1
