"""Compiled loop of `heat`: M motors of four lumps over L steps."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SLOPE = 0.0039
_REFERENCE = 60.0


@njit(cache=True)
def step(p: Array, square: float, speed: float, ambient: float, extra: Array, dt: float, x: Array
         ) -> None:  # fmt: skip
    """One step of one motor, x (4,) in place; linear parts implicit, so that any dt is stable."""
    copper = p[0] * square
    # Winding and core together: two linear equations, backward Euler.
    a11 = 1.0 + dt * (p[1] - _SLOPE * copper)
    a12 = -dt * p[1]
    air = p[5] + p[6] * speed
    a21 = -dt * p[2]
    a22 = 1.0 + dt * (p[2] + air)
    b1 = x[0] + dt * (copper * (1.0 - _SLOPE * _REFERENCE) + extra[0])
    b2 = x[1] + dt * (p[3] * speed + p[4] * speed * speed + air * ambient + extra[1])
    det = a11 * a22 - a12 * a21
    x[0] = (b1 * a22 - a12 * b2) / det
    x[1] = (a11 * b2 - a21 * b1) / det
    x[2] = (x[2] + dt * (p[7] * x[1] + p[8] * speed + p[9] * ambient + extra[2])) / (
        1.0 + dt * (p[7] + p[9])
    )
    x[3] = (x[3] + dt * (p[10] * x[1] + p[11] * speed + p[12] * ambient + extra[3])) / (
        1.0 + dt * (p[10] + p[12])
    )


@njit(cache=True)
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
    """Readings (K, M, 3) at the end of the steps `at`; arguments as `heat.predict`."""
    k = 0
    for n in range(speed.shape[0]):
        for m in range(parameters.shape[0]):
            step(parameters[m], square[n, m], speed[n], ambient[n], extra[m], dt, state[m])
        while k < at.shape[0] and at[k] == n:
            for m in range(parameters.shape[0]):
                p = parameters[m]
                out[k, m, 0] = state[m, 0] + p[13]
                out[k, m, 1] = state[m, 2] + p[14]
                out[k, m, 2] = state[m, 3] + p[15]
            k += 1
