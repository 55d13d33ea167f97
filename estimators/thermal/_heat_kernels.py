"""Compiled loop of `heat`: M motors of five lumps over L steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators._lean import njit

Array = NDArray[np.float64]

SLOPE = 0.0039
REFERENCE = 60.0


@njit(cache=True, error_model="numpy")
def step(p: Array, square: float, speed: float, ambient: float, extra: Array, dt: float, x: Array
         ) -> None:  # fmt: skip
    """One step of one motor, x (5,) in place; linear parts implicit, so that any dt is stable."""
    copper = p[0] * square
    air = p[7] + p[8] * speed
    # Winding, core, frame: a chain of three linear equations, backward Euler, solved from its ends.
    own_w = 1.0 + dt * (p[1] - SLOPE * copper)
    own_c = 1.0 + dt * (p[2] + p[5])
    own_f = 1.0 + dt * (p[6] + air)
    w = (x[0] + dt * (copper * (1.0 - SLOPE * REFERENCE) + extra[0])) / own_w
    f = (x[2] + dt * (air * ambient + extra[2])) / own_f
    c = x[1] + dt * (p[3] * speed + p[4] * speed * speed + extra[1])
    to_core_w, to_core_f = dt * p[1] / own_w, dt * p[6] / own_f
    x[1] = (c + dt * (p[2] * w + p[5] * f)) / (own_c - dt * (p[2] * to_core_w + p[5] * to_core_f))
    x[0] = w + to_core_w * x[1]
    x[2] = f + to_core_f * x[1]
    x[3] = (x[3] + dt * (p[9] * x[2] + p[10] * speed + p[11] * ambient + extra[3])) / (
        1.0 + dt * (p[9] + p[11])
    )
    x[4] = (x[4] + dt * (p[12] * x[2] + p[13] * speed + p[14] * ambient + extra[4])) / (
        1.0 + dt * (p[12] + p[14])
    )


@njit(cache=True, error_model="numpy")
def coupling(p: Array, square: float, speed: float, a: Array) -> None:
    """Fill a (5, 5) 1/s: how fast deviations of the lumps change; see `heat.coupling`."""
    a[:] = 0.0
    a[0, 0], a[0, 1] = -p[1] + SLOPE * p[0] * square, p[1]
    a[1, 0], a[1, 1], a[1, 2] = p[2], -p[2] - p[5], p[5]
    a[2, 1], a[2, 2] = p[6], -p[6] - p[7] - p[8] * speed
    a[3, 2], a[3, 3] = p[9], -p[9] - p[11]
    a[4, 2], a[4, 4] = p[12], -p[12] - p[14]


@njit(cache=True, error_model="numpy")
def simulate(
    parameters: Array,
    square: Array,
    speed: Array,
    ambient: Array,
    extra: Array,
    at: NDArray[np.int64],
    dt: float,
    state: Array,
    out: Array,
) -> None:
    """Lumps (K, M, 5) at the end of the steps `at`; arguments as `heat.predict`."""
    k = 0
    for n in range(speed.shape[0]):
        for m in range(parameters.shape[0]):
            step(parameters[m], square[n, m], speed[n], ambient[n], extra[m], dt, state[m])
        while k < at.shape[0] and at[k] == n:
            out[k] = state
            k += 1
